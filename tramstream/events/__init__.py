"""Events: what happened as kind and facts, worded only where people read; no room of ours below."""
