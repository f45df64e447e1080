"""The decoder of Mode S as an application: `motes demo mode_s`, and `motes run`, `motes plan` and `motes study` of its settings."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from motes.applications.interface import Job, Score
from motes.applications.mode_s.amplitude import detected
from motes.applications.mode_s.messages import Message, message, once, positions, right
from motes.applications.mode_s.model import bits, series
from motes.applications.mode_s.parity import Verdict, is_long, judged, number
from motes.applications.mode_s.preambles import BITS, Preambles, find, noise_power
from motes.applications.mode_s.recording import RATE, read_samples, write_samples
from motes.applications.mode_s.settings import Settings
from motes.applications.mode_s.world import received
from motes.core import checks
from motes.core.findings import Diagnosis
from motes.filters import keep as keeping
from motes.filters import notices
from motes.filters.history import History
from motes.filters.interface import Filter
from motes.filters.jump_markov import JumpMarkovFilter
from motes.filters.keep import Keep
from motes.filters.run import run_in_chunks
from motes.io.result_table import Table

LAG = 3
"""Bits after which a bit is decided."""
MOST_NOISE = 1e6
AT_A_TIME = 32
"""Messages after which those that were decoded are printed."""


def load(settings: Settings, seed: int) -> "ModeSJob":
    """Read the recording that the settings name, or make one up, and find its preambles.

    Args:
        settings: of the application.
        seed: of a recording that is made up, and of noise that is added.

    Raises:
        FileError: the file cannot be used, or holds no message.
        MotesError: a setting cannot be used.
    """
    if not 0.3 <= settings.share < 1:
        checks.refuse("share", "at least 0.3 and below 1", settings.share)
    if not 0 <= settings.noise <= MOST_NOISE:
        checks.refuse("noise", f"between 0 and {MOST_NOISE:g}", settings.noise)
    world = None if settings.data else received(seed, settings.aircraft, settings.seconds, settings.snr)
    samples = read_samples(settings.data, settings.samples) if world is None else world.samples
    if settings.noise:
        rng = np.random.default_rng(seed)
        samples = samples + settings.noise / np.sqrt(2) * (rng.standard_normal(len(samples)) + 1j * rng.standard_normal(len(samples)))
    found = find(samples, settings.share)
    if not len(found.sample):
        hint = "Is it of 1090 MHz at 2 million samples a second, and are the samples written as the settings say?"
        checks.refuse(settings.data or "recording", "at least one preamble of Mode S", f"none in {len(samples)} samples", hint,
                      checks.FileError if settings.data else checks.MotesError)
    ys, inputs = series(samples, found, noise_power(samples))
    return ModeSJob(
        model=bits(), ys=ys, inputs=inputs, samples=samples, found=found, sent=() if world is None else world.sent,
        filters={"jump_markov": JumpMarkovFilter(n=6, on_collapse="predict")}, keep=keeping.modes(lag=LAG),
    )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class ModeSJob(Job):
    """A recording with its preambles; a step is a bit, and messages come one after the other, after one step without a measurement.

    Attributes:
        samples: complex, `(t,)`.
        found: the preambles.
        sent: what was sent in a recording that was made up: first sample and bits of each message.
    """

    samples: np.ndarray
    found: Preambles
    sent: tuple[tuple[int, np.ndarray], ...]

    @cached_property
    def by_amplitude(self) -> list[Message]:
        """The right messages that magnitudes alone give."""
        return detected(self.samples)

    def pieces(
        self, seed: int, filter: Filter, ys: Any, inputs: Any, keep: Keep, chunk: int, after: History | None = None
    ) -> Iterator[History]:
        """Run a filter; the pieces are of few messages, so that these are told as they come."""
        return run_in_chunks(seed, filter, self.model, ys, inputs, keep, min(chunk, AT_A_TIME * BITS), after)

    def track(self, history: History) -> None:
        """Return nothing: what is found are messages, whose table has the positions."""
        return

    def diagnosed(self, history: History) -> Diagnosis:
        """Judge by whether estimates are numbers: parity tells right messages from others, which a false preamble gives, too."""
        return Diagnosis.of([notices.numbers(history)])

    def about(self) -> str:
        """Tell of the recording."""
        seconds = len(self.samples) / RATE
        return f"{seconds:.3g} s, {len(self.found.sample)} preambles; noise {np.sqrt(noise_power(self.samples)):.3g} rms a sample."

    def news(self) -> Callable[[History], Sequence[str]]:
        """Return what spells the messages that a piece completed; answers wait until a squitter has told their address."""
        waiting: list[tuple[int, Verdict]] = []
        known: set[int] = set()
        rest, done = np.zeros((0, 0)), 0

        def told(piece: History) -> list[str]:
            nonlocal rest, done, waiting
            rows = np.concatenate([rest, _ones(piece)]) if len(rest) else _ones(piece)
            whole = len(rows) // BITS
            verdicts = self._judged(rows[: whole * BITS], done)
            rest, done = rows[whole * BITS :], done + whole
            known.update(verdict.address for _, verdict in verdicts if verdict.certain)
            both = waiting + verdicts
            waiting = [(sample, verdict) for sample, verdict in both if verdict.address not in known]
            right_now = [message(sample, verdict) for sample, verdict in both if verdict.address in known]
            return [f"{one.sample / RATE:10.6f} s  {one}" for one in once(right_now)]

        return told

    def decoded(self, pieces: Sequence[History]) -> list[Message]:
        """Return the messages that are right of those that were gone through.

        Args:
            pieces: of one run, in order, with what `keep.modes(lag=...)` keeps.

        Raises:
            MotesError: the modes were not kept.
        """
        return right(self._judged(np.concatenate([_ones(piece) for piece in pieces]), 0))

    def _judged(self, rows: np.ndarray, first: int) -> list[tuple[int, Verdict]]:
        """Judge messages by the probabilities of their bits, `(112 k, lag + 1)`, from the preamble of a number on."""
        each = rows[: len(rows) // BITS * BITS].reshape(-1, BITS, rows.shape[1])
        found = [(int(sample), judged(decided(ones))) for sample, ones in zip(self.found.sample[first:], each, strict=False)]
        return [(sample, verdict) for sample, verdict in found if verdict is not None]

    def title(self, steps: int) -> str:
        """Return the number of preambles."""
        return f"{len(self.found.sample)} preambles, {steps} bits; messages are right that their parity says are"

    def scores(self, history: History) -> tuple[Score, ...]:
        """Count the messages, beside those that magnitudes alone give."""
        ours, usual = self.decoded([history]), self.by_amplitude
        found = {"messages": len(ours), "by amplitude": len(usual), "lost of these": len(_lacking(usual, ours))}
        if self.sent:
            bits_sent = {(number(bits), len(bits)) for _, bits in self.sent}
            wrong = sum((number(one.bits), len(one.bits)) not in bits_sent for one in ours)
            found |= {"sent": len(self.sent), "wrong": wrong}
        return tuple(Score(name, float(value), digits=0) for name, value in found.items())

    def verdict(self, history: History) -> str:
        """Tell of each aircraft what it said."""
        messages = self.decoded([history])
        places = positions(messages, RATE)
        lines = []
        for address in sorted({one.address for one in messages}):
            own = [one for one in messages if one.address == address]
            names = sorted({one.callsign for one in own if one.callsign})
            heights = [one.altitude for one in own if one.altitude is not None]
            told = [f"{address:06x}: {len(own)} messages", *names, *([f"{heights[-1]} ft"] if heights else [])]
            told += [f"{places[address][0]:.5f}, {places[address][1]:.5f} degrees"] if address in places else []
            lines.append(", ".join(told))
        return "\n".join(lines) or "no message"

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Draw a message, and how many are right at which strength."""
        from motes.applications.mode_s.pictures import message_figure

        return {"messages.png": message_figure(next(iter(histories.values())), self)}

    def tables(self, history: History) -> dict[str, Table]:
        """List the messages."""
        columns = ("seconds", "address", "format", "altitude_ft", "callsign", "squawk", "bits")
        rows = tuple((one.sample / RATE, f"{one.address:06x}", one.kind, one.altitude, one.callsign or None, one.squawk or None,
                      f"{number(one.bits):0{len(one.bits) // 4}x}") for one in self.decoded([history]))  # fmt: skip
        return {"messages": Table(columns, rows)}

    def written(self, folder: Path, settings: Settings) -> Settings:
        """Write a recording that was made up, in the form of the real ones."""
        if settings.data:
            return settings
        path = folder / "recording.bin"
        write_samples(path, self.samples, settings.samples)
        return replace(settings, data=str(path), noise=0.0)


def _ones(piece: History) -> np.ndarray:
    """Return the probabilities of ones of the bits in a piece; the first step of a run is none."""
    ones = np.asarray(piece.delayed_mode_probabilities)[..., 1]
    return ones[1:] if int(piece.start) == 0 else ones


def decided(ones: np.ndarray) -> np.ndarray:
    """Decide the bits of a message, each once as many are known after it as were kept; what follows the message says nothing of it.

    Args:
        ones: probabilities of ones, `(112, lag + 1)`, those of the last bits at each bit.
    """
    bits = keeping.after_lag(ones, ones.shape[1] - 1) > 0.5
    if not is_long(bits):
        half = BITS // 2
        bits = np.append(keeping.after_lag(ones[:half], ones.shape[1] - 1) > 0.5, np.zeros(half, bool))
    return bits


def _lacking(wanted: Sequence[Message], there: Sequence[Message]) -> list[Message]:
    """Return the messages that others lack: of the same bits, within a few samples."""
    samples = np.array([one.sample for one in there])
    return [one for one in wanted if not (len(samples) and np.abs(samples - one.sample).min() <= 4)]
