"""A bag as the data of a user's own model: its topics by the user's names, brought to one line of steps."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from motes.cli.options import refuse, shown

TIME = "time"
"""What the times of the steps are called among the arrays, seconds."""


def on_one_line(
    file: str, asked: Mapping[str, str], columns: tuple[str, ...], inputs: tuple[str, ...], truth: tuple[str, ...]
) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Read the topics of a bag and bring them to one line of steps.

    Each time at which something was measured is a step, at which that is NaN which was not measured then; inputs are what the last message
    before said (steps before the first are left out), true states lie between the messages around a step (NaN where there are none).

    Args:
        file: of the bag.
        asked: topics and fields by names of the user's own, as for `read_bag`.
        columns: names of what was measured; all that are neither inputs nor truth if none is named.
        inputs: names of inputs.
        truth: names of true states.

    Returns:
        The names of what was measured, and arrays by name, time axis first, with "time" of each step, seconds.

    Raises:
        MotesError: no topic is named, or a name is none of a topic; nothing was measured once all inputs are there; what `read_bag` raises.
    """
    from motes.io.bags import opened, read_bag
    from motes.models.times import times

    if not asked:
        with opened(file) as bag:
            refuse("data topics", "topics by names of your own", "none", f"There are {bag.told():.300}.")
    if TIME in asked:
        refuse("data topics", f"other names than {TIME!r}, which is that of the steps", repr(TIME))
    aside = (*inputs, *truth)
    names = columns or tuple(name for name in asked if name not in aside)
    for name in (*names, *aside):
        if name not in asked:
            refuse("data", f"names among the topics: {', '.join(asked):.200}", shown(name))
    if not names:
        refuse("data columns", "at least one topic that is measured", "none beside inputs and truth")
    topics = read_bag(file, {name: asked[name] for name in (*names, *aside)}).topics
    begin = max((topics[name].seconds[0] for name in inputs), default=-np.inf)
    sensors = {}
    for name in names:
        heard = topics[name].seconds >= begin
        if not heard.any():
            refuse(f"data {name}", f"messages from {begin:g} s on, where inputs begin", f"the last at {topics[name].seconds[-1]:g} s")
        # pictures as numbers, so that NaN can stand for those that were not taken
        values = topics[name].values[heard]
        sensors[f"topic {name}"] = (topics[name].seconds[heard], values.astype(np.float32) if values.dtype == np.uint8 else values)
    line = times(**sensors)
    steps = line.start + line.seconds
    arrays = {name: line.ys[f"topic {name}"] for name in names} | {name: topics[name].held(steps) for name in inputs}
    arrays |= {name: topics[name].at(steps) for name in truth} | {TIME: steps}
    lost = next((name for name in truth if np.isnan(arrays[name]).all()), None)
    if lost:
        refuse(f"data {lost}", f"true states between {steps[0]:g} and {steps[-1]:g} s", "none", "Are the clocks of both topics the same?")
    return names, arrays
