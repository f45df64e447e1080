"""Symbols by Markov chains and by jump-Markov filters: eight users on one channel, and two antennas over a channel that fades.

    python examples/multiuser/run.py [--words 30000] [--frames 60] [--particles 32]

Everything is simulated. Two tables are printed; pictures go to out/detection.png and out/channel.png. It takes about ten minutes.
"""

import argparse
from pathlib import Path

import channel
import detection

DECIBELS = (0, 2, 4, 6, 8, 10, 12)
CHANNEL_DECIBELS = (0, 3, 6, 9, 12, 15)


def main():
    """Simulate, print both tables and draw both pictures."""
    parser = argparse.ArgumentParser(description="Detection of symbols.")
    parser.add_argument("--words", type=int, default=30_000, help="of eight bits, at 8 dB and more; fewer where errors are many (30000)")
    parser.add_argument("--frames", type=int, default=60, help="over the fading channel (60)")
    parser.add_argument("--particles", type=int, default=32, help="of the jump-Markov filter (32)")
    given = parser.parse_args()
    Path("out").mkdir(exist_ok=True)
    found = detection.compared(DECIBELS, given.words)
    print(found.table())
    detection.picture(found).savefig("out/detection.png", dpi=80)
    found = channel.compared(CHANNEL_DECIBELS, given.frames, given.particles)
    print(found.table())
    channel.picture(found, channel.followed(given.particles)).savefig("out/channel.png", dpi=80)
    print("pictures: out/detection.png, out/channel.png")


if __name__ == "__main__":
    main()
