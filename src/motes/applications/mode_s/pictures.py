"""Pictures of decoded messages: one with its bits, and which preambles gave one."""

from typing import Any

import numpy as np

from motes.applications.mode_s.preambles import BITS, HEAD, noise_power
from motes.filters.history import History
from motes.filters.keep import after_lag
from motes.plotting.figures import ESTIMATE, INERTIAL, OTHER, legend_below, new_figure, tidy


def message_figure(history: History, job: Any) -> Any:
    """Draw the weakest message that is right, with the probabilities of its bits; under it all preambles by strength and share explained.

    Args:
        history: with the modes kept.
        job: what was run.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = new_figure(10, 7.5)
    axes = figure.subplot_mosaic([["pulses"], ["bits"], ["all"]], height_ratios=[1, 0.8, 1.3])
    for one in axes.values():
        tidy(one)
    messages, found = job.decoded([history]), job.found
    ours, usual = ({one.sample for one in some} for some in (messages, job.by_amplitude))
    decibels = 10 * np.log10(np.abs(found.amplitude) ** 2 / noise_power(job.samples))
    by_amplitude = np.array([any(abs(sample - other) <= 4 for other in usual) for sample in found.sample], bool)
    by_filter = np.array([sample in ours for sample in found.sample], bool)
    axes["all"].plot(decibels[~by_filter], found.share[~by_filter], "x", color="0.6", markersize=4, label="no message")
    groups = ((by_filter & by_amplitude, ESTIMATE, "by both"), (by_filter & ~by_amplitude, INERTIAL, "by the filter alone"))
    for some, color, name in groups:
        axes["all"].plot(decibels[some], found.share[some], "o", color=color, markersize=4, label=name)
    axes["all"].set(title=f"Preambles: {len(ours)} messages are right, {len(usual)} by amplitude", ylabel="share explained",
                    xlabel="signal-to-noise ratio of a pulse, dB")  # fmt: skip
    rows = np.flatnonzero(by_filter)
    if len(rows):
        row = rows[np.argmin(decibels[rows])]
        message = next(one for one in messages if one.sample == found.sample[row])
        count = len(message.bits)
        sample = int(found.sample[row])
        window = np.abs(job.samples[sample : sample + HEAD + 2 * count])
        time = np.arange(len(window)) / 2
        axes["pulses"].stairs(window, np.append(time, time[-1] + 0.5), color="0.35")
        axes["pulses"].set(title=f"The weakest message: {message} ({decibels[row]:.1f} dB)", ylabel="magnitude")
        ones = np.asarray(history.delayed_mode_probabilities)[1 + row * BITS : 1 + (row + 1) * BITS, :, 1]
        place = np.arange(count)
        axes["bits"].plot(8 + place + 0.5, message.bits, "s", color=OTHER, markersize=4, label="bit")
        axes["bits"].plot(8 + place + 0.5, after_lag(ones[:count], ones.shape[1] - 1), ".", color=ESTIMATE, label="probability of a one")
        axes["bits"].set(ylabel="bit", xlabel="microseconds after the preamble began", ylim=(-0.15, 1.15))
        axes["pulses"].sharex(axes["bits"])
        axes["bits"].legend(loc="center right", frameon=True, framealpha=0.9, fontsize=8)
    legend_below(figure, axes["all"], 3)
    return figure
