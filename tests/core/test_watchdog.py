"""What a watch over long work says, and when."""

import time

import pytest

from motes.core import watchdog
from motes.core.settings import enforced, in_force
from motes.core.workers import Workers


def test_silence_is_told_and_progress_is_not(monkeypatch, capsys):
    monkeypatch.setattr(watchdog, "SILENCE", 0.6)
    with watchdog.watched("sample", lambda: "3 of 20 steps", "; the draws so far are kept") as progressed:
        for _ in range(8):
            time.sleep(0.1)
            progressed()
        early = capsys.readouterr().err
        time.sleep(1.2)
    said = capsys.readouterr().err
    assert said.startswith("sample: no progress for 1 s at 3 of 20 steps. The process is ")
    assert len(set(said.splitlines())) == 1  # a slow machine may say it twice
    assert said.endswith("Ctrl-C ends it; the draws so far are kept.\n")
    assert early == ""
    time.sleep(1.0)
    assert capsys.readouterr().err == ""


def test_workers_give_results_errors_and_an_end():
    with Workers(2) as workers:
        found = [workers.submit(divmod, 7, k) for k in (2, 0)]
        assert found[0].result() == (3, 1)
        with pytest.raises(ZeroDivisionError):
            found[1].result()


def test_settings_of_one_thread_in_another():
    import jax
    import jax.numpy as jnp

    with jax.enable_x64(True), jax.default_matmul_precision("highest"):
        settings = in_force()

    def work():
        with enforced(settings):
            return in_force(), jnp.zeros(1).dtype

    with Workers(1) as workers:
        assert workers.submit(work).result() == (settings, jnp.float64) and workers.submit(in_force).result() == in_force()
