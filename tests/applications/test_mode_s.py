"""Messages of transponders: parity and fields, a made-up recording, a real one, and files that are none."""

from pathlib import Path

import numpy as np
import pytest

import data
import motes as mo
from motes.applications.mode_s import messages
from motes.applications.mode_s.amplitude import detected
from motes.applications.mode_s.job import decided, load
from motes.applications.mode_s.parity import judged, number, remainder, with_parity
from motes.applications.mode_s.preambles import BITS, find, pulses
from motes.applications.mode_s.settings import Settings
from motes.applications.mode_s.world import received
from motes.cli.main import main


def as_bits(spelled):
    return np.array([int(bit) for bit in f"{int(spelled, 16):0{4 * len(spelled)}b}"])


def read(spelled):
    verdict = judged(np.concatenate([as_bits(spelled), np.zeros(112 - 4 * len(spelled), int)]))
    return messages.message(0, verdict)


def test_published_messages_are_read():
    """Examples of Sun 2021, The 1090 Megahertz Riddle: callsign, position of an even and an odd message, velocity, altitude."""
    named = read("8D4840D6202CC371C32CE0576098")
    assert (named.kind, f"{named.address:06x}", named.callsign) == (17, "4840d6", "KLM1023")
    even, odd = read("8D40621D58C382D690C8AC2863A7"), read("8D40621D58C386435CC412692AD6")
    assert even.altitude == 38000 and even.compact == (0, 93000, 51372) and odd.compact == (1, 74158, 50194)
    assert np.allclose(messages.position(even.compact, odd.compact), (52.2572, 3.91937), atol=1e-4)
    flying = read("8D485020994409940838175B284F")
    assert flying.velocity == (-8, -159) and "159 kt" in str(flying)
    assert read("8D4840D6202CC371C32CE0576098").bits.sum() == as_bits("8D4840D6202CC371C32CE0576098").sum()


@pytest.mark.parametrize("place", [(52.2, 3.9), (-33.9, 151.2), (0.01, -0.02), (86.9, 179.9), (-59.99, -179.99)])
def test_a_position_that_is_sent_is_read(place):
    found = messages.position(messages.compacted(*place, 1), messages.compacted(*place, 0))
    assert np.allclose(found, place, atol=1e-3) or (abs(found[1] - place[1]) < 5e-2 and abs(place[0]) > 80)


def test_parity_finds_every_single_and_double_error():
    """The polynomial divides no pattern of one or two errors in 112 bits; what is laid over the parity comes out again."""
    rng = np.random.default_rng(0)
    message = with_parity(rng.integers(0, 2, 88), overlay=0x4D2023)
    assert remainder(message) == 0x4D2023
    message = with_parity(rng.integers(0, 2, 88))
    left = np.array([remainder(np.bitwise_xor(message, np.arange(112) == place)) for place in range(112)])
    assert remainder(message) == 0 and left.all() and len(set(left)) == 112


def test_pulses_are_found_where_they_were_put():
    """Sample, shift, amplitude and turn of a preamble without noise."""
    rng = np.random.default_rng(1)
    samples = 0.01 * (rng.standard_normal(400) + 1j * rng.standard_normal(400))
    turn = 2 * np.pi * 3 / 128
    samples[50:66] += pulses(0.425) * 2j * np.exp(1j * turn * np.arange(16))
    found = find(samples, 0.9)
    at = np.argmax(found.share)
    assert (found.sample[at], found.shift[at], found.turn[at]) == (50, 0.425, turn)
    assert abs(found.amplitude[at] - 2j) < 0.05 and found.share[at] > 0.99


def test_bits_are_decided_by_what_comes_before_the_end_of_their_message():
    """Of a short message the second half says nothing."""
    ones = np.full((BITS, 4), 0.9)
    ones[56:59, 1:] = 0.1
    ones[:8] = 0.1
    assert not decided(ones)[:5].any() and (decided(ones)[53:56] == 1).all()


def right_and_wrong(seconds, snr, seed=0, aircraft=4):
    job = load(Settings(aircraft=aircraft, seconds=seconds, snr=snr), seed)
    history = mo.run(0, job.filters["jump_markov"], job.model, job.ys, job.inputs, keep=job.keep)
    sent = {(sample, number(bits)) for sample, bits in job.sent}
    found = {(one.sample, number(one.bits)) for one in job.decoded([history])}
    near = {bits for _, bits in found}
    return sum(bits in near for _, bits in sent), len(sent), len(near - {bits for _, bits in sent}), job


def test_a_made_up_recording_is_decoded():
    """At 15 dB every parity is right, and no message is made of what is none; amplitudes alone lose some."""
    right, sent, wrong, job = right_and_wrong(0.008, 15.0)
    assert right == sent >= 8 and wrong == 0
    assert len(detected(job.samples)) <= sent


@pytest.mark.night
def test_all_parities_are_right_at_15_decibels():
    for seed in range(3):
        right, sent, wrong, _ = right_and_wrong(0.1, 15.0, seed, 8)
        assert right == sent >= 150 and wrong == 0, seed


@pytest.mark.night
@pytest.mark.parametrize(("noise", "least", "times"), [(0.0, 280, 1.0), (12.0, 150, 1.4)])
def test_a_real_recording(noise, least, times):
    """More messages than amplitudes alone give, and of theirs at most a few are lost, none without added noise."""
    job = load(Settings(data=str(data.recorded("comms/modes1.bin")), noise=noise), 0)
    history = mo.run(0, job.filters["jump_markov"], job.model, job.ys, job.inputs, keep=job.keep)
    scores = {score.name: score.value for score in job.scores(history)}
    assert scores["messages"] >= max(least, times * scores["by amplitude"]) and scores["lost of these"] <= (3 if noise else 0)


@pytest.mark.night
def test_the_command_tells_messages_as_they_come(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "modes", "--seconds", "0.004", "--aircraft", "2"]) == 0
    assert "format 17" in capsys.readouterr().out
    assert next(Path("out").glob("*messages.csv")).read_text().count("\n") > 4


def test_files_that_are_no_recordings(tmp_path):
    """A file that ends within a sample is read; silence, a constant carrier and short files are refused in one line."""
    path = tmp_path / "some.bin"
    for content, message in ((b"", "at least 241 samples"), (bytes([128] * 100), "at least 241 samples"),
                             (bytes([127, 128] * 5000), "at least one preamble of Mode S, got none"),
                             (bytes([200, 90] * 5000), "at least one preamble of Mode S, got none")):  # fmt: skip
        path.write_bytes(content)
        with pytest.raises(mo.FileError, match=message):
            load(Settings(data=str(path)), 0)
    with pytest.raises(mo.FileError, match="a file that can be read"):
        load(Settings(data=str(tmp_path / "none.bin")), 0)
    world = received(0, 1, 0.004, 20.0)
    for form in ("unsigned8", "signed16"):
        job = load(Settings(aircraft=1, seconds=0.004, snr=20.0), 0)
        job.written(tmp_path, Settings(samples=form))
        whole = load(Settings(data=str(tmp_path / "recording.bin"), samples=form), 0)
        assert np.abs(whole.samples - world.samples).max() <= np.sqrt(0.5) + 1e-6
        path.write_bytes((tmp_path / "recording.bin").read_bytes()[:-1])
        with pytest.warns(mo.MotesWarning, match="into a sample"):
            cut = load(Settings(data=str(path), samples=form), 0)
        assert np.array_equal(cut.samples, whole.samples[:-1])
    for wrong, message in ((Settings(share=1.5), "share"), (Settings(noise=-1.0), "noise"), (Settings(aircraft=0), "aircraft"),
                           (Settings(seconds=0.0), "seconds"), (Settings(snr=np.nan), "snr")):  # fmt: skip
        with pytest.raises(mo.MotesError, match=message):
            load(wrong, 0)
