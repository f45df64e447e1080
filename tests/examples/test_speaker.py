"""A speaker in a room: delays, rendering, recordings, and small runs against what was rendered."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.io import wavfile

import motes as mo
from examples_of import loaded

RATE = 16_000


@pytest.fixture(scope="module")
def run():
    return loaded("speaker")


@pytest.fixture(scope="module")
def room(run):
    return run["read_room"](run["Path"](run["__file__"]).parent / "room.toml")


@pytest.fixture(scope="module")
def dry(run, room):
    """Three seconds in a room whose walls send little back."""
    return run["rendered"](room, 1, 3.0, 0.12, 1)


def spoken(room, rate, seconds, place):
    """Noise from one place as all microphones hear it, without walls, to the sample."""
    rng = np.random.default_rng(0)
    away = np.linalg.norm(np.append(place, room.mouth) - room.microphones.reshape(-1, 3), axis=1)
    times = np.arange(int(seconds * rate)) / rate
    waves, phases = rng.uniform(200, 3800, 400), rng.uniform(0, 2 * np.pi, 400)
    return np.stack([np.cos(2 * np.pi * np.outer(times - far / 343, waves) + phases).sum(axis=1) / far for far in away], axis=1)


@pytest.mark.parametrize("rate", [8_000, 16_000, 44_100])
def test_delays_are_those_of_the_place_at_any_rate(run, room, rate):
    place = np.array([1.3, 2.9])
    heard = run["correlated"](spoken(room, rate, 0.5, place), rate, room.longest)
    lags = (heard.correlation.mean(axis=0).argmax(axis=-1) - heard.correlation.shape[-1] // 2) / 4
    mouth = np.append(place, room.mouth)
    away = np.linalg.norm(mouth - room.microphones, axis=-1)
    assert np.abs(lags - (away[:, 1] - away[:, 0]) / 343 * 16_000).max() < 0.26
    assert np.linalg.norm(np.median(run["model"].loudest(room, jnp.asarray(heard.correlation)), axis=0) - place) < 0.15


def test_speaker_of_a_dry_room_is_followed(run, room, dry, tmp_path):
    assert dry.heard.sound.any() and not dry.heard.sound.all()
    one = run["Heard"](*(rows[0] for rows in dry.heard))
    shown, sd = run["followed"](room, one, 300, dry.path[0])
    error = np.linalg.norm(shown.mean - dry.path[0], axis=1)[31:]
    assert np.median(error) < 0.15 and error.max() < 0.8
    run["picture"](room, shown).savefig(tmp_path / "speaker.png")
    assert len(run["places_of"](shown, sd).rows) == 94


def test_recordings_that_do_not_fit_are_refused_in_one_line(run, room, tmp_path):
    def refused(name, rate, samples, words):
        path = tmp_path / name
        wavfile.write(path, rate, samples)
        with pytest.raises(mo.FileError, match=words) as error:
            run["read_wav"](path, room)
        assert "\n" not in str(error.value)

    sound = (1000 * np.random.default_rng(0).normal(size=(RATE, 8))).astype(np.int16)
    refused("mono.wav", RATE, sound[:, 0], "expected 8 channels.*got 1")
    refused("stereo.wav", RATE, sound[:, :2], "got 2")
    refused("slow.wav", 4_000, sound, "8000 samples a second at least, got 4000")
    refused("short.wav", RATE, sound[:100], "a frame of 32 ms")
    refused("still.wav", RATE, 0 * sound, "got silence")
    refused("nan.wav", RATE, np.full((RATE, 8), np.nan, np.float32), "NaN")
    (tmp_path / "text.wav").write_text("no sound")
    with pytest.raises(mo.FileError, match="expected a WAV file"):
        run["read_wav"](tmp_path / "text.wav", room)
    with pytest.raises(mo.FileError, match="expected a WAV file"):
        run["read_wav"](tmp_path / "nowhere.wav", room)
    wavfile.write(tmp_path / "good.wav", RATE, sound)
    samples, rate = run["read_wav"](tmp_path / "good.wav", room)
    assert rate == RATE and (samples == sound).all()


def test_rooms_that_are_none_are_refused_in_one_line(run, tmp_path):
    path, text = tmp_path / "room.toml", "size = [5, 4, 2.6]\nmouth = {}\n[pairs]\nsouth = [[2, {}, 1], [3, 0, 1]]\n"
    outside, none = "some outside", "expected a room"
    for mouth, y, words in ((1.5, -1, outside), (3, 0, outside), ('"high"', 0, none), (1.5, "x", none)):
        path.write_text(text.format(mouth, y))
        with pytest.raises(mo.FileError, match=words):
            run["read_room"](path)


@pytest.mark.night
def test_figures_of_the_page(run, room):
    """Figures of the README's table, with room for other compilers."""
    table, _ = run["compared"](room, 20, 1000, 15.0)
    rows = {row[:2]: row[2:] for row in table.rows}
    for name in ("whole correlation", "whole correlation, recovering"):
        assert rows[0.25, name][0] < 0.17 and rows[0.25, name][3] == 0
        assert rows[0.45, name][0] < 0.32 and rows[0.45, name][3] <= 2
        assert rows[0.25, name][0] < rows[0.25, "three peaks, clutter .7"][0] < rows[0.25, "frame by frame"][0] / 3
    assert rows[0.25, "whole correlation, recovering"][4] < rows[0.25, "whole correlation"][4] < 2.5
