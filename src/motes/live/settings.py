"""What a user can set of a live run: the table `[live]` of a TOML file, and flags. Imports no JAX."""

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class Live:
    """Measurements as they come.

    Attributes:
        on: take measurements one by one as they come (`--live` is short for it, and `--source` implies it).
        source: "-" for standard input; a file of JSON lines; udp://127.0.0.1:5005; tcp://host:port or ipc://path, where a ZeroMQ socket
            publishes; serial:///dev/ttyUSB0?baud=115200. The measurements that the application has, at their own speed, if not given.
        speed: how many times as fast as it was recorded what has been recorded is replayed; 0 for as fast as the filter takes it.
        sinks: where results go: "-" for standard output, a file of JSON lines, a folder NAME.parquet, tcp://*:5006 to publish by ZeroMQ.
        columns: names of what is measured; those of the data, or the sensors, or "y" for all of it, if not given.
        time: name of the time stamps, seconds; that of the data, or "time", if not given.
        number: name of the number of a message, where it has one that grows: tells order and duplicates in place of the time.
        fields: what the numbers of a line are that is no JSON, in order; time, columns and inputs if not given.
        late: what is done with a message that is older than one before: "fold in" goes back to its place and comes again from there, to the
            bits of a run in order; "wait" holds all back for `wait` seconds; "drop" leaves it out.
        lag: how many steps "fold in" goes back at most.
        wait: seconds by which "wait" holds messages back.
        duplicate: what is done with a message that has come before: "drop" or "take".
        clock_jump: what is done where the clock of the source was set: "bridge" counts the usual step, "begin anew" has the filter begin
            again, "stop" ends the run.
        jump: seconds by which times must go back, or ahead of what has passed here, to be a jump.
        checkpoint: seconds between checkpoints.
        resume: go on from the checkpoint that is there.
        patience: seconds without a message after which the run ends; 0 for never.
        budget: time that a step may take, with its unit, such as 5ms: chooses the number of particles, and a smaller one where steps keep
            running late.
    """

    on: bool = False
    source: str = field(default="", metadata={"path": True})
    speed: float = 1.0
    sinks: tuple[str, ...] = field(default=("-",), metadata={"path": True})
    columns: tuple[str, ...] = ()
    time: str = ""
    number: str = ""
    fields: tuple[str, ...] = ()
    late: Literal["fold in", "wait", "drop"] = "fold in"
    lag: int = 20
    wait: float = 0.1
    duplicate: Literal["drop", "take"] = "drop"
    clock_jump: Literal["bridge", "begin anew", "stop"] = "bridge"
    jump: float = 10.0
    checkpoint: float = 10.0
    resume: bool = True
    patience: float = 0.0
    budget: str = ""

    @property
    def is_asked_for(self) -> bool:
        """Whether measurements are taken as they come."""
        return self.on or bool(self.source)
