"""What a user can set of the decoder of Mode S."""

from dataclasses import dataclass, field
from typing import Literal

DEMO = "modes"
"""The demonstration: `motes demo modes`."""


@dataclass(frozen=True)
class Settings:
    """Decode the transponders of aircraft (Mode S, ADS-B) from a radio recording of 1 090 MHz at 2 million samples a second.

    Attributes:
        data: the recording: I and Q in turn, as `rtl_sdr` writes them; one with known messages is made up where no file is named.
        samples: how a sample is written: "unsigned8" (RTL-SDR) or "signed16" (little endian).
        aircraft: number of aircraft of a recording that is made up.
        seconds: how long that is.
        snr: energy of its pulses over the noise of a sample, dB.
        share: of the energy about a preamble, what its four pulses must explain for it to be decoded.
        noise: root mean square of noise that is added to the recording, in units of its samples, to see what it costs.
    """

    data: str = field(default="", metadata={"path": True})
    samples: Literal["unsigned8", "signed16"] = "unsigned8"
    aircraft: int = 4
    seconds: float = 0.1
    snr: float = 15.0
    share: float = 0.6
    noise: float = 0.0
