"""Where is the speaker? Four pairs of microphones in a room that echoes.

    python examples/speaker/run.py [--runs 20] [--particles 1000] [--seconds 15]
    python examples/speaker/run.py --wav FILE [--room FILE]

Without a recording, a voice of synthetic syllables is rendered in the room of room.toml with reverberation of 0.25 and 0.45 s, and all ways
to track it are compared. With one, where the speaker is goes to out/speaker.csv. The picture goes to out/speaker.png.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import model
import numpy as np
from delays import FRAME, Heard, correlated
from pictures import Shown, picture
from recording import read_wav
from room import ORDER, Room, read_room
from trials import Worlds, found_again, handed_over, held_on, judged, rendered, tracked, ways

import motes as mo

REVERBERATIONS = (0.25, 0.45)
"""Seconds in which sound falls by 60 dB."""
DRAWN = 300
"""Particles of the picture."""


def cloud(law: Any) -> dict[str, jax.Array]:
    """Keep the mean place, the standard deviations, and some particles."""
    return {"mean": law.mean()[:2], "sd": jnp.sqrt(jnp.diag(law.cov())[:2]), "cloud": law.sample(jax.random.key(0), DRAWN)[:2]}


def followed(room: Room, heard: Heard, particles: int, path: np.ndarray | None = None) -> tuple[Shown, np.ndarray]:
    """Track one recording; return what is to be drawn, and standard deviations `(t, 2)`."""
    one = Heard(*(rows[None] for rows in heard))
    history = tracked(model.recovering(room, particles), model.tracking(room, model.whole(room)), one.correlation, one, cloud)
    kept = {name: np.asarray(rows[0]) for name, rows in history.kept.items()}
    frames = held_on(np.asarray(model.loudest(room, jnp.asarray(heard.correlation)))[None], one.sound)[0]
    return Shown(kept["mean"], kept["cloud"], heard.sound, path, frames), kept["sd"]


def compared(room: Room, runs: int, particles: int, seconds: float, order: int = ORDER) -> tuple[mo.io.Table, Worlds]:
    """Return a table of all ways in all reverberations, and the worlds of the last."""
    rows = []
    for reverberation in REVERBERATIONS:
        worlds = rendered(room, runs, seconds, reverberation, order)
        other = handed_over(worlds)
        found, again = (ways(room, those, particles) for those in (worlds, other))
        rows += [(reverberation, name, *judged(found[name], worlds), found_again(again[name], other)) for name in found]
    head = ("reverberation, s", "way", "error speaking, m", "at all times", "away", "lost", "found again, s")
    return mo.io.Table(head, tuple(rows)), worlds


def places_of(shown: Shown, sd: np.ndarray) -> mo.io.Table:
    """Return a table of where the speaker is in each frame."""
    rows = [(round(FRAME * step, 3), *map(float, (*shown.mean[step], *sd[step])), int(shown.sound[step])) for step in range(len(sd))]
    return mo.io.Table(("seconds", "x", "y", "sd x", "sd y", "sound"), tuple(rows))


def main():
    """Compare all ways, or track a recording; draw the picture."""
    parser = argparse.ArgumentParser(description="Speaker tracking.")
    parser.add_argument("--runs", type=int, default=20, help="rendered recordings in each reverberation (20)")
    parser.add_argument("--particles", type=int, default=1000, help="number of particles (1000)")
    parser.add_argument("--seconds", type=float, default=15.0, help="length of a rendered recording (15)")
    parser.add_argument("--order", type=int, default=ORDER, help=f"most reflections of a rendered sound ({ORDER})")
    parser.add_argument("--wav", type=Path, help="recording with two channels for each pair of the room")
    parser.add_argument("--room", type=Path, default=Path(__file__).parent / "room.toml", help="room and microphones (room.toml)")
    given = parser.parse_args()
    try:
        room = read_room(given.room)
        sound = read_wav(given.wav, room) if given.wav else None
    except mo.MotesError as error:
        sys.exit(str(error))
    Path("out").mkdir(exist_ok=True)
    if sound is None:
        table, worlds = compared(room, given.runs, given.particles, given.seconds, given.order)
        print(table)
        shown, _ = followed(room, Heard(*(rows[0] for rows in worlds.heard)), given.particles, worlds.path[0])
    else:
        shown, sd = followed(room, correlated(*sound, room.longest), given.particles)
        table = places_of(shown, sd)
        Path("out/speaker.csv").write_text(table.to_csv())
        print(mo.io.Table(table.columns, table.rows[:: round(1 / FRAME)]), "all frames: out/speaker.csv", sep="\n")
    picture(room, shown).savefig("out/speaker.png", dpi=80)
    print("picture: out/speaker.png")


if __name__ == "__main__":
    main()
