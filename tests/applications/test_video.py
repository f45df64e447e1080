"""A target in a clip: what is worked out of pictures, what is learned, clips of all kinds, the rendered clip and the recorded one."""

import colorsys
import csv
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import recorded, refused
from motes.applications.video import job as tracking
from motes.applications.video.boosting import boosted
from motes.applications.video.colour import distance, histograms
from motes.applications.video.features import moving, pool, values, within
from motes.applications.video.frames import BINS, HUES, colour_table, looked_at, of_stride
from motes.applications.video.job import load
from motes.applications.video.settings import Settings
from motes.applications.video.target import LOST, overlap
from motes.applications.video.world import World
from motes.cli import long_runs
from motes.cli.asked import Run, asked
from motes.cli.main import main
from motes.core.checks import FileError, MotesError
from motes.filters import pieces
from motes.io.clips import read_clip, write_clip

pytestmark = pytest.mark.jax

PLAIN = partial(World, twin=False, bar=False, light=1.0, turn=0.0, gone=0)
CAR = {"frame": 207, "box": ("317,132,165,287",), "frames": 29}
BAR = slice(12, 15)


@pytest.fixture
def rendered(monkeypatch):
    """Return what follows the target of a clip, rendered as it says; the overlap with the true boxes `(t,)` comes last."""

    def follow(world, seed, **settings):
        monkeypatch.setattr(tracking, "World", type("World", (World,), {"__new__": lambda cls, *_: world, "count": world.count}))
        monkeypatch.setattr(tracking.World, "__init__", lambda self, *_: None)
        job = load(Settings(frames=world.count, **settings), seed)
        history = mo.run(seed, job.worn(job.filters["particle"]), job.model, job.ys(), keep=job.keep)
        return job, history, overlap(job.targets[0].found(history), world.boxes)

    return follow


def test_sums_and_features_are_those_of_the_pixels():
    generator = np.random.default_rng(1)
    before, picture = generator.integers(0, 256, (2, 33, 41, 3), dtype=np.uint8)
    y = list(looked_at([before, None, picture], (2,)))
    assert y[1] is None and y[2]["sums"].shape == (4, 18, 22) and y[2]["bins"].shape == (17, 21)
    red, green, blue = np.moveaxis(picture[::2, ::2].astype(int), 2, 0)
    old = before[::2, ::2].astype(int).sum(axis=2) // 3
    channels = np.stack([(red + green + blue) // 3, red - green, blue - (red + green) // 2, np.abs((red + green + blue) // 3 - old)])
    sums = jnp.asarray(y[2]["sums"])
    for channel in range(4):
        total, area = within(sums, jnp.array([[3.0], [-4.0], [30.0], [9.0]]), channel)
        assert float(total[0]) == channels[channel, 0:9, 3:21].sum() and float(area[0]) == 9 * 18
    box = jnp.array([[4.0], [3.0], [14.0], [13.0]])
    features = pool()
    found = np.asarray(values(sums, box, features))[:, 0]
    for number in range(0, 150, 30):
        left, top, right, bottom = np.round(np.array([4, 3, 4, 3]) + 10 * np.asarray(features.centre[number])).astype(int)
        outer = np.round(np.array([4, 3, 4, 3]) + 10 * np.asarray(features.surround[number])).astype(int).clip(0, [21, 17, 21, 17])
        part = channels[int(features.channel[number])]
        inside, around = part[top:bottom, left:right], part[outer[1] : outer[3], outer[0] : outer[2]]
        ring = (around.sum() - inside.sum()) / max(1, around.size - inside.size)
        wanted = (inside.sum() / max(1, inside.size) - ring) / (channels[0, :17, :19].mean() + 4)
        assert abs(found[number] - wanted) < 1e-4
    assert -1 <= float(moving(sums, box)[0]) <= 1


def test_colours_have_the_bins_of_their_hue():
    table = colour_table()
    assert table.max() < BINS
    for red, green, blue in ((250, 10, 10), (10, 200, 90), (30, 40, 220), (200, 190, 40)):
        hue, saturation, _ = colorsys.rgb_to_hsv(*((part // 8 + 0.5) / 32 for part in (red, green, blue)))
        assert table[(red >> 3 << 10) | (green >> 3 << 5) | (blue >> 3)] == int(hue * HUES) * HUES + int(saturation * HUES)
    assert table[0] == HUES * HUES and table[-1] == BINS - 1, "black and white have no hue"
    bins = jnp.zeros((20, 30), jnp.uint8).at[:, 15:].set(7)
    one = histograms(bins, jnp.array([[5.0, 40.0], [2.0, 2.0], [25.0, 60.0], [18.0, 9.0]]))
    assert np.allclose(one[0, [0, 7]], 0.5) and not one[1].any(), "out of sight has no colour"
    assert float(distance(one[0], one[0])) < 1e-6 and float(distance(one[0], one[1])) == 1


def test_boosting_finds_what_tells_the_classes_apart():
    generator = np.random.default_rng(2)
    target = jnp.arange(200) < 60
    noise = generator.normal(size=(30, 200)).astype(np.float32)
    noise[[4, 17]] += 1.6 * np.where(target, 1, -1) * np.array([[1.0], [-1.0]])
    ensemble = boosted(jnp.asarray(noise), target, jnp.where(jnp.arange(200) < 150, 1.0, 0.0))
    assert {4, 17} <= set(np.asarray(ensemble.chosen).tolist()) and abs(float(ensemble.weight.sum()) - 1) < 1e-5
    scores = ensemble.score(jnp.asarray(noise)[ensemble.chosen])
    assert np.mean((np.asarray(scores) > 0) == np.asarray(target)) > 0.93


def saved(path, pictures, exact=True):
    write_clip(str(path), pictures, Fraction(25), exact)
    return path


def test_clips_of_all_kinds(tmp_path):
    generator = np.random.default_rng(3)
    odd = [generator.integers(0, 256, (61, 83, 3), dtype=np.uint8) for _ in range(4)]
    clip = read_clip(saved(tmp_path / "odd.mkv", odd))
    assert (clip.width, clip.height, clip.rate) == (83, 61, 25)
    assert all(np.array_equal(one, other) for one, other in zip(odd, clip.pictures(), strict=True)), "nothing is lost"
    assert read_clip(saved(tmp_path / "odd.mp4", odd, exact=False)).width == 84
    smooth = np.broadcast_to(np.linspace(0, 250, 80).astype(np.uint8)[None, :, None], (60, 80, 3))
    path = saved(tmp_path / "turned.mp4", [smooth] * 3, exact=False)
    data = path.read_bytes()
    place = data.index(b"tkhd") + 44
    quarter = bytes.fromhex("000000000001000000000000ffff0000000000000000000000000000000000000040000000"[:72])
    path.write_bytes(data[:place] + quarter + data[place + 36 :])
    turned = read_clip(path)
    assert (turned.width, turned.height) == (60, 80)
    shown = next(turned.pictures())
    assert np.abs(shown.astype(int) - np.rot90(smooth, -1)).mean() < 4, "a quarter clockwise, as the file says"
    av = pytest.importorskip("av")
    with av.open(str(tmp_path / "grey.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 80, 60, "gray"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(smooth[..., 0]), format="gray")))
        container.mux(stream.encode())
    grey = next(read_clip(tmp_path / "grey.mkv").pictures())
    assert np.array_equal(grey[..., 0], grey[..., 2]) and np.abs(grey.astype(int) - smooth).max() <= 1


@pytest.mark.night
def test_the_model_draws_pictures_as_they_are_looked_at():
    """Of the first state the first picture itself, but for the noise of the camera; elsewhere the target is where the state is."""
    job = load(Settings(frames=12), 0)
    picture, model, target = next(job.ys.shown()), job.simulated(), job.targets[0]
    states = jnp.stack([model.initial.mean(), jnp.array([160.0, 120.0, float(model.initial.mean()[2])])], axis=1)
    drawn = model.sensor.sample(jax.random.key(0), states, None, 0)
    wanted = next(looked_at([picture], (1,)))
    assert drawn["sums"].dtype == wanted["sums"].dtype and drawn["bins"].dtype == wanted["bins"].dtype
    sums = [np.asarray(drawn["sums"][..., place]) for place in (0, 1)]
    assert sums[0].shape == wanted["sums"].shape
    assert np.abs(np.diff(np.diff(sums[0][0] - wanted["sums"][0], axis=0), axis=1)).mean() < 3
    box = look_inside(wanted["sums"], target.box), look_inside(sums[1], np.array([138, 102, 44, 36]))
    assert np.abs(box[0] - box[1]).max() < 4, "the target is put down there"
    assert np.abs(look_inside(sums[1], target.box) - box[0]).max() > 10, "and is no longer where it was cut out"
    ys = jax.tree.map(lambda leaf: leaf[..., 0], drawn)
    density = model.sensor.density(ys, states, None, 0)
    assert density[0] > density[1] + 20


def look_inside(sums, box):
    """Return the mean of the first three channels over a box."""
    left, top, width, height = (int(side) for side in box)
    corners = sums[:3, top + height, left + width] - sums[:3, top, left + width] - sums[:3, top + height, left] + sums[:3, top, left]
    return corners / (width * height)


def test_a_damaged_picture_is_a_step_without_measurement(tmp_path):
    pictures = list(PLAIN(4, 24).pictures())
    path = saved(tmp_path / "good.mkv", pictures)
    av = pytest.importorskip("av")
    with av.open(str(path)) as container:
        packets = [(one.pos, one.size) for one in container.demux(video=0) if one.size]
    data, packet = bytearray(path.read_bytes()), packets[6]
    data[packet[0] + 4 : sum(packet)] = b"\xff" * (packet[1] - 4)
    path.write_bytes(data)
    found = list(read_clip(path).pictures())
    assert len(found) == 24 and found[6] is None and all(one is not None for one in found[:6])
    box = PLAIN(4, 24).boxes[0]
    job = load(Settings(data=str(path), box=(",".join(map(str, box)),)), 0)
    history = mo.run(0, job.worn(job.filters["particle"]), job.model, job.ys(), keep=job.keep)
    assert np.asarray(history.info.log_evidence)[6] == 0 and len(history.ess) == 24
    short = tmp_path / "short.mkv"
    short.write_bytes(path.read_bytes()[: packets[12][0]])
    job = load(Settings(data=str(short), box=(",".join(map(str, box)),), frames=24), 0)
    history = mo.run(0, job.worn(job.filters["particle"]), job.model, job.ys(), keep=job.keep)
    assert "The clip ended after 12 of 24 pictures." in job.verdict(history)


def test_a_piece_has_a_picture_that_shows_its_form(monkeypatch):
    monkeypatch.setattr(pieces, "BYTES", 1)
    job = load(Settings(frames=10), 0)
    picture = next(job.ys())
    given = iter([picture, None, None, picture, picture])
    assert [len(piece) for piece, _ in pieces.gathered(job.model, given, None)] == [1, 3, 1]


def test_what_cannot_be_followed_is_told_in_one_line(tmp_path):
    path = str(saved(tmp_path / "clip.mkv", list(PLAIN(4, 10).pictures())))
    good = {"box": ("9,9,40,40",)}
    for changes, words in (({"box": ("300,10,40,40",)}, "box inside 320 x 240"), ({"box": ("-3,10,40,40",)}, "box inside"),
                           ({"box": ("10,10,4,40",)}, "box 8 pixels"), ({"box": ("10,10,40",)}, "box x,y,w,h"), ({}, "box none"),
                           ({"box": ("9,9,40,40", "300,10,40,40")}, "box 2 inside 320 x 240 300,10,40,40"),
                           (good | {"frame": 30}, "frame 30"), (good | {"frame": -1}, "frame -1"),
                           (good | {"cues": ("smell",)}, "cues colour"), (good | {"cues": ()}, "cues")):  # fmt: skip
        with pytest.raises(MotesError) as error:
            load(Settings(data=path, **changes), 0)
        refused(error, *words.split()[:1])
        assert all(word in str(error.value) for word in words.split()), (words, str(error.value))
    with pytest.raises(MotesError, match="frame: expected the number of a picture in which the target is to be seen, got 165"):
        load(Settings(frame=165), 0)
    (tmp_path / "list.m3u8").write_text("#EXTM3U\n#EXTINF:1,\nhttp://example.org/clip.ts\n")
    (tmp_path / "noise.mp4").write_bytes(np.random.default_rng(0).bytes(3000))
    whole = saved(tmp_path / "whole.mp4", list(PLAIN(4, 10).pictures()), exact=False).read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.mp4").write_bytes(b"")
    for name in ("list.m3u8", "noise.mp4", "cut.mp4", "empty.mp4", "none.mp4"):
        with pytest.raises(FileError) as error:
            read_clip(tmp_path / name)
        refused(error, name)


def spoiled(folder):
    """Write files that are no clips, or only in part; returns one of ten pictures of 320 x 240."""
    av = pytest.importorskip("av")
    pictures = list(PLAIN(4, 10).pictures())
    clip = saved(folder / "clip.mkv", pictures)
    with av.open(str(clip)) as container:
        packets = [(one.pos, one.size) for one in container.demux(video=0) if one.size]
    data = clip.read_bytes()
    whole = saved(folder / "whole.mp4", pictures, exact=False).read_bytes()
    (folder / "folder.mp4").mkdir()
    for name, content in (("empty.mp4", b""), ("text.mp4", b"frame,x,y,w,h\n" * 40), ("cut.mp4", whole[: len(whole) // 2]),
                          ("head.mkv", data[: packets[0][0]]), ("table.csv", b"frame,x,y,w,h\n0,1,2,3,4\n")):  # fmt: skip
        (folder / name).write_bytes(content)
    spoilt = bytearray(data)
    for pos, size in packets:
        spoilt[pos + 4 : pos + size] = b"\xff" * (size - 4)
    (folder / "none_decodes.mkv").write_bytes(spoilt)
    with av.open(str(folder / "sound.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 4000), np.int16), layout="mono")
        sound.rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode())
    return clip


def test_what_is_no_clip_is_one_line_of_the_command(tmp_path, capsys):
    clip = spoiled(tmp_path)
    box = ["--box", "9,9,40,40"]
    broken = ("empty.mp4", "text.mp4", "cut.mp4", "head.mkv", "table.csv", "folder.mp4", "none.mp4")
    asked_for = [(name, box, "expected") for name in broken]
    asked_for += [
        ("sound.mkv", box, "a clip with pictures, got one without"),
        ("none_decodes.mkv", box, "pictures that can be decoded"),
        (clip.name, [*box, "--frame", "10"], "a picture that can be decoded, got 10, of a clip that ends before"),
        (clip.name, [*box, "--box", "300,10,40,40"], "box 2: expected one inside of the picture, 320 x 240 pixels, got 300,10,"),
        (clip.name, ["--box", "9,9"], "box: expected x,y,w,h"),
        (clip.name, [], "box: expected x,y,w,h"),
    ]
    for name, flags, words in asked_for:
        assert main(["run", "video", "--data", str(tmp_path / name), *flags, "--out", str(tmp_path / "out")]) == 2, name
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1 and words in lines[0] and len(lines[0]) < 520, (name, lines)
    assert not (tmp_path / "out").exists()


def test_a_clip_of_which_the_end_is_missing_is_followed_to_there(tmp_path):
    """In Matroska up to the byte at which it ends; an MP4 that has its index in front, too."""
    av = pytest.importorskip("av")
    pictures = list(PLAIN(4, 20).pictures())
    with av.open(str(tmp_path / "whole.mp4"), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": "20", "bf": "0"})
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    data = (tmp_path / "whole.mp4").read_bytes()
    (tmp_path / "short.mp4").write_bytes(data[: 9 * len(data) // 10])
    clip = read_clip(tmp_path / "short.mp4")
    found = [one for one in clip.pictures() if one is not None]
    assert clip.count == 20 and 2 < len(found) < 20
    ys = list(load(Settings(data=str(tmp_path / "short.mp4"), box=("9,9,40,40",)), 0).ys())
    assert len(ys) == len(found) and ys[-1] is not None, "it ends with its last picture that can be decoded"


@pytest.mark.night
def test_pictures_without_colour_are_followed(tmp_path):
    world = PLAIN(4, 12)
    grey = [np.broadcast_to(one.mean(axis=2, keepdims=True).astype(np.uint8), one.shape) for one in world.pictures()]
    job = load(Settings(data=str(saved(tmp_path / "grey.mkv", grey)), box=(",".join(map(str, world.boxes[0])),)), 0)
    history = job.piece(0, job.filters["particle"], list(job.ys()), job.keep, None)
    assert overlap(job.targets[0].found(history), world.boxes).min() > 0.6
    single = load(Settings(data=str(tmp_path / "grey.mkv"), box=("9,9,40,40",), frame=11), 0)
    assert len(list(single.ys())) == 1, "the last picture alone is a clip, too"


@pytest.mark.night
def test_a_target_is_found_again_where_it_comes_back(rendered):
    """It is gone for twenty pictures and comes back elsewhere; one world here, twenty by night."""
    world = PLAIN(3, 120, gone=15)
    job, history, shared = rendered(world, 0)
    assert np.nanmean(shared[:96]) > 0.8
    assert job.targets[0].is_lost(history)[102:111].all() and not job.targets[0].is_lost(history)[:94].any()
    assert np.mean(shared[114:]) > 0.7
    assert "Lost" in job.verdict(history) and job.scores(history)[0].value < 20


def same_bits(*histories):
    leaves = (jax.tree.leaves((one.kept, one.info, one.last.state)) for one in histories)
    return all(np.array_equal(one, other, equal_nan=True) for one, other in zip(*leaves, strict=True))


@pytest.mark.night
def test_a_killed_run_goes_on_with_the_same_bits(tmp_path, monkeypatch):
    monkeypatch.setattr(long_runs, "EVERY", 0.0)
    job = load(Settings(frames=36), 1)
    filter = job.filters["particle"]

    def run():
        return long_runs.long_run(1, filter, job, job.keep, tmp_path / "run" / "particle")

    whole = mo.filters.joined(list(run()))
    kept = list((tmp_path / "run").glob(f".*{long_runs.ENDING}"))
    assert len(kept) == 1 and [len(part.ess) for part in run()] == [36], "what is done is not done again"
    long_runs.forget()
    cut = run()
    next(cut), next(cut)
    cut.close()
    parts = list(run())
    assert len(parts[0].ess) in (12, 24) and len(parts) > 1
    again = mo.filters.joined(parts)
    assert same_bits(whole, again)
    assert np.array_equal(mo.run(1, job.worn(filter), job.model, job.ys(), keep=job.keep).mean, whole.mean)
    ys = list(job.ys())
    assert np.array_equal(np.asarray(ys[14]["sums"]), next(job.ys(14))["sums"]), "what moved is known from the picture before"


@pytest.mark.night
def test_several_targets_are_each_followed_as_if_alone(tmp_path, monkeypatch):
    """Also where the run of both was cut and goes on from what it kept."""
    monkeypatch.setattr(long_runs, "EVERY", 0.0)
    boxes = spelled_boxes(World(1, 36))

    def run(*which):
        job = load(Settings(frames=36, box=which), 1)
        return job, long_runs.long_run(1, job.filters["particle"], job, job.keep, tmp_path / str(len(which)))

    _, cut = run(*boxes)
    next(cut), next(cut)
    cut.close()
    job, rest = run(*boxes)
    parts = list(rest)
    assert len(parts) > 1 and len(parts[0].ess) in (12, 24)
    both = mo.filters.joined(parts)
    assert both.mean.shape == (36, 6) and both.cov.shape == (36, 6, 6) and both.names[3:] == ("x_2", "y_2", "log_size_2")
    for (_, own), box in zip(job.each(both), boxes, strict=True):
        alone = mo.filters.joined(list(run(box)[1]))
        assert same_bits(own, alone) and np.array_equal(own.log_likelihood, alone.log_likelihood)
    assert len(list(tmp_path.glob(f".*{long_runs.ENDING}"))) == 3, "each has a file of its own"


def test_pictures_are_looked_at_once_for_boxes_of_all_sizes():
    pictures = list(PLAIN(4, 10).pictures())[:3]
    both = list(looked_at([pictures[0], None, *pictures[1:]], (1, 2)))
    assert both[1] is None
    for stride in (1, 2):
        alone = list(looked_at(pictures, (stride,)))
        for one, other in zip([both[0], *both[2:]], alone, strict=True):
            assert all(np.array_equal(of_stride(one, stride)[name], other[name]) for name in ("bins", "sums"))


def spelled_boxes(world):
    """Return the boxes of the target and of what stands below or above it in the first picture, as a user gives them."""
    left, top, width, height = world.boxes[0].tolist()
    return tuple(f"{left:g},{up:g},{width:g},{height:g}" for up in (top, top + (50 if top < 120 else -50)))


def test_the_command_writes_clip_boxes_and_strip(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    one, other = spelled_boxes(World(0, 24))
    assert main(["demo", "video", "--frames", "24", "--box", one, "--box", other]) == 0
    said = capsys.readouterr().out
    assert "overlap" in said and "2 targets" in said and "Target 1: " in said and "Target 2: " in said
    rows = list(csv.DictReader(Path("out/particle_boxes.csv").open()))
    assert {"frame", "time", "target", "x", "y", "w", "h", "score", "lost"} == set(rows[0])
    assert [(row["frame"], row["target"]) for row in rows] == [(str(step), name) for step in range(24) for name in ("1", "2")]
    assert asked(Run, ["out/video.toml"], "motes run").own().box == (one, other)
    clip = read_clip("out/followed.mp4")
    assert (clip.width, clip.height, len(list(clip.pictures()))) == (320, 240, 24)
    drawn = np.asarray(next(clip.pictures())).astype(int)
    bare = next(World(0, 24).pictures()).astype(int)
    changed = np.abs(drawn - bare).mean(axis=2)
    for box in (one, other):
        left, top, width, _ = (int(float(side)) for side in box.split(","))
        edge, inside = (changed[row : row + 3, left + 8 : left + width - 8].mean() for row in (top - 1, top + 5))
        assert edge > inside + 15, "each box is drawn where its target is"
    assert not list(Path("out").glob(f".*{long_runs.ENDING}"))


@pytest.mark.night
@pytest.mark.optimized
def test_of_twenty_lost_targets_nineteen_are_found_within_ten_pictures(rendered):
    found = []
    for seed in range(20):
        _, _, shared = rendered(PLAIN(seed, 200, gone=20), seed)
        found.append((shared[180:190] > 0.5).any() and np.mean(shared[190:]) > 0.5)
    assert sum(found) >= 19, found


@pytest.mark.night
@pytest.mark.optimized
def test_a_hue_that_turns_is_learned(rendered):
    """By 120 degrees over half of the clip: means of twenty clips of the overlap; what is frozen is off in the last quarter."""
    for learning in (True, False):
        shared = np.array([rendered(PLAIN(seed, 200, turn=120.0), seed, learning=learning)[2] for seed in range(20)])
        whole, end = shared.mean(), shared[:, 150:].mean()
        assert (whole >= 0.7 and end >= 0.5) if learning else end < 0.3, (learning, whole, end)


class Changed:
    """The recorded clip with something done to its pictures."""

    def __init__(self, clip, change):
        self.clip, self.change, self.rate, self.count = clip, change, clip.rate, clip.count

    def pictures(self, begin=0):
        for number, picture in enumerate(self.clip.pictures(begin), begin):
            yield self.change(number - CAR["frame"], picture.copy())


def changes(job):
    """What is done to the pictures, by name; each is a function of step and picture."""
    beside = slice(132, 132 + 287), slice(512, 512 + 165)
    twin = next(job.ys.source.pictures(CAR["frame"]))[132 : 132 + 287, 317 : 317 + 165]

    def bar(step, picture):
        if BAR.start <= step < BAR.stop:
            left, _, width, _ = job.targets[0].boxes[CAR["frame"] + step]
            picture[:, max(0, int(left - 10)) : int(left + width + 10)] = 128
        return picture

    def doubled(step, picture):
        picture[beside] = twin
        return picture

    return {"clean": lambda step, picture: picture, "bar": bar, "twin": doubled,
            "light": lambda step, picture: picture // 2 if step >= BAR.start else picture}  # fmt: skip


@pytest.mark.night
@pytest.mark.optimized
@pytest.mark.parametrize("name", ["clean", "bar", "light", "twin"])
def test_the_car_is_followed(name):
    """Twenty seeds: means, and the score under the bar and elsewhere."""
    settings = Settings(data=str(recorded("video/car-detection.mp4")), truth=str(recorded("video/car-detection_red_car_gt.csv")), **CAR)
    ys, off, shared, under, elsewhere = None, [], [], [], []
    for seed in range(20):
        job = load(settings, seed)
        if ys is None:
            ys = list(replace(job.ys, source=Changed(job.ys.source, changes(job)[name]))())
        history = mo.run(seed, job.worn(job.filters["particle"]), job.model, ys, keep=job.keep)
        seen = np.ones(len(ys), bool)
        seen[BAR] = name != "bar"
        found, true = job.targets[0].found(history), np.array([job.targets[0].boxes[CAR["frame"] + step] for step in range(len(ys))])
        off.append(np.hypot(*(found[:, :2] + found[:, 2:] / 2 - true[:, :2] - true[:, 2:] / 2).T)[seen].mean())
        shared.append(overlap(found, true)[seen].mean())
        under.append(job.targets[0].score_of(history)[BAR].max())
        elsewhere.append(np.delete(job.targets[0].score_of(history), np.arange(len(ys))[BAR]).min())
    assert np.mean(off) <= 8 and np.mean(shared) >= (0.85 if name == "clean" else 0.83), (off, shared)
    assert min(shared) > 0.7 and min(elsewhere) > LOST, "none is lost"
    assert name != "bar" or max(under) < LOST, under


PEAK = """
import re, tempfile
from pathlib import Path
from motes.applications.video.job import load
from motes.applications.video.settings import Settings
from motes.cli.long_runs import long_run
def peak(frames):
    job = load(Settings(frames=frames), 0)
    for _ in long_run(0, job.filters["particle"], job, job.keep, Path(tempfile.mkdtemp()) / "run"):
        pass
    # what the process itself had; what it inherited does not count
    return int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024
begin = peak(120)
print(peak({frames}) - begin)
"""


@pytest.mark.night
@pytest.mark.optimized
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the system does not tell the peak of a process")
def test_memory_does_not_grow_with_the_clip():
    """Beside that of 120 pictures, for which all is compiled: both are whole pieces."""
    said = subprocess.run([sys.executable, "-W", "ignore", "-c", PEAK.format(frames=1008)], capture_output=True, text=True, timeout=600)
    assert float(said.stdout) < 100, said


@pytest.mark.night
@pytest.mark.optimized
def test_a_killed_command_goes_on(tmp_path):
    """Killed once it has kept something; the same command gives the bits of one that was never killed. Boxes of two sizes."""
    code = "import sys\nfrom motes.cli import long_runs, main\nlong_runs.EVERY = 0.0\nsys.exit(main.main(sys.argv[1:]))"
    boxes = ("--box", "30,40,44,36", "--box", "100,60,150,125")
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}

    def command(out):
        words = [sys.executable, "-W", "ignore", "-c", code, "demo", "video", "--frames", "240", *boxes, "--out", str(tmp_path / out)]
        return subprocess.Popen(words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    first = command("killed")
    until = time.monotonic() + 300
    while not list((tmp_path / "killed").glob(f".*{long_runs.ENDING}")) and time.monotonic() < until:
        time.sleep(0.05)
    first.send_signal(signal.SIGKILL)
    assert first.wait() == -signal.SIGKILL
    assert command("killed").wait(300) == 0 and command("whole").wait(300) == 0
    one, other = (mo.History.load(tmp_path / out / "particle.npz") for out in ("killed", "whole"))
    assert same_bits(one, other)
