"""Events: what happened as kind and facts, worded only where people read; no room of ours below."""

from tramstream.events.kinds import Event as Event
from tramstream.events.kinds import Kind as Kind
from tramstream.events.kinds import declared as declared
from tramstream.events.kinds import define as define
