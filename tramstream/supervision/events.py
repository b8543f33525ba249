"""What a supervisor sees of its nodes and does with them, and what a node does without one."""

from __future__ import annotations

from tramstream.events.kinds import ERROR, INFO, define

ENDING_OTHERS = define(
    "supervisor.ending_others",
    "ending what a run before has left: {nodes}",
    cause="Nodes of a run that was killed still live, and have other settings or were about to "
    "end: they are not taken over.",
    nodes=str,
)
NO_ANSWER = define(
    "supervisor.no_answer",
    "node {node} does not answer; killing it",
    cause="The node's process is there, and does not react on the bus.",
    node=str,
)
HEARD_AGAIN = define(
    "supervisor.heard_again",
    "node {node} is heard again",
    cause="A node that had given no heartbeat gives them again.",
    severity=INFO,
    node=str,
)
NODE_ENDED = define(
    "supervisor.node_ended",
    "node {node} ended with status {status}; starting it again in {again_s}",
    cause="The node's process has ended by itself or was killed (a status below zero is a signal).",
    severity=ERROR,
    node=str,
    status=int,
    again_s=float,
)
NODE_GONE = define(
    "supervisor.node_gone",
    "node {node} ended; starting it again in {again_s}",
    cause="The same of a node that a supervisor before this one had started: only that one knew "
    "the status.",
    severity=ERROR,
    node=str,
    again_s=float,
)
NODE_SILENT = define(
    "supervisor.node_silent",
    "node {node} has given no heartbeat for {limit_s}",
    cause="The node is frozen, or the computer very busy.",
    node=str,
    limit_s=float,
)
NODE_FROZEN = define(
    "supervisor.node_frozen",
    "node {node} has given no heartbeat for {limit_s}; killing it, for another to take its place",
    cause="The node is frozen.",
    severity=ERROR,
    node=str,
    limit_s=float,
)
BUS_DEAD = define(
    "supervisor.bus_dead",
    "the bus does not carry; whether the recorder hears is not known",
    cause="The router is frozen or gone while the run ends.",
    severity=ERROR,
)
NOT_STARTED = define(
    "supervisor.not_started",
    "{reason}",
    cause="A recorder that was to hear the last of the others ended at its start.",
    cure="{advice}",
    severity=ERROR,
    reason=str,
    advice=str,
)
RECORDER_DEAF = define(
    "supervisor.recorder_deaf",
    "node {node} did not hear the others end; the last messages may be missing",
    cause="The recorder died or froze while the run ended: its last messages may be missing.",
    severity=ERROR,
    node=str,
)
RECORDER_BROKEN_OFF = define(
    "supervisor.recorder_broken_off",
    "node {node} {how} at the end; what was published last may be missing",
    cause="The recorder did not end in order.",
    severity=ERROR,
    node=str,
    how=str,
)
DOES_NOT_END = define(
    "supervisor.does_not_end",
    "node {node} does not end; killing it",
    cause="The node was told to end and did not within 10 s (the recorder: 40 s).",
    node=str,
)
NOT_ON_BUS = define(
    "supervisor.not_on_bus",
    "node {node} is not on the bus after {limit_s}; going on",
    cause="The node is slow to start.",
    node=str,
    limit_s=float,
)
ROSTER_REFUSED = define(
    "supervisor.roster_refused",
    "{folder}: {reason}; should this process be killed, the nodes end with it",
    cause="Who runs the vehicle cannot be written down, for the runtime folder takes no file.",
    cure="make room there, or set $.bus.runtime_dir",
    folder=str,
    reason=str,
)
NO_SUPERVISOR = define(
    "node.no_supervisor",
    "no supervisor for {limit_s}; ending",
    cause="Supervisor and router were killed together, or nobody may take over.",
    cure="start `tramstream run` again",
    severity=ERROR,
    limit_s=float,
)
NO_SUCCESSOR = define(
    "node.no_successor",
    "no successor can be started: {reason}",
    cause="The supervisor has vanished, and the command that would start another fails.",
    cure="start `tramstream run` again",
    severity=ERROR,
    reason=str,
)
TAKEN_OVER = define(
    "node.taken_over",
    "the supervisor (process {before}) has vanished; process {successor} takes over",
    cause="The supervisor was killed.",
    before=int,
    successor=int,
)
LEFT_OUT = define(
    "supervisor.left_out",
    "{key}: {size_bytes} are {reason}; left out, as are {left_out} so far",
    cause="Somebody publishes on a health key what is no message of it.",
    cure="see with `tramstream top` who publishes it",
    key=str,
    size_bytes=int,
    reason=str,
    left_out=int,
)
NOT_BELIEVED = define(
    "supervisor.not_believed",
    "session {session} tells of losses in the recorder's name and is not the recorder; it is not "
    "believed, nor are others",
    cause="Somebody publishes losses on the recorder's key.",
    cure="end that program",
    session=str,
)
