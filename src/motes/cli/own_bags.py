"""A bag as the data of a user's own model: its topics by the user's names, brought to one line of steps."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from motes.cli.options import refuse, shown

if TYPE_CHECKING:
    from motes.cli.own import Data

TIME = "time"
"""What the times of the steps are called among the arrays, seconds."""


def on_one_line(data: "Data") -> "tuple[Data, dict[str, Any]]":
    """Read the topics of a bag and bring them to one line of steps.

    Each time at which something was measured is a step, at which that is NaN which was not measured then; inputs are what the last message
    before said (steps before the first are left out), true states lie between the messages around a step (NaN where there are none).

    Args:
        data: what is asked for of the bag.

    Returns:
        The same with the name of the times and of what was measured, and arrays by name, time axis first.

    Raises:
        MotesError: no topic is named, or a name is none of a topic; nothing was measured once all inputs are there; what `read_bag` raises.
    """
    from motes.io.bags import opened, read_bag
    from motes.models.times import times

    if not data.topics:
        with opened(data.file) as bag:
            refuse("data topics", "topics by names of your own", "none", f"There are {bag.told():.300}.")
    if data.time or TIME in data.topics:
        refuse("data", f"neither time nor a topic called {TIME!r} beside a bag", f"time = {shown(data.time)}" if data.time else repr(TIME),
               "Messages have times of their own.")  # fmt: skip
    aside = (*data.inputs, *data.truth)
    names = data.columns or tuple(name for name in data.topics if name not in aside)
    for name in (*names, *aside):
        if name not in data.topics:
            refuse("data", f"names among the topics: {', '.join(data.topics):.200}", shown(name))
    if not names:
        refuse("data columns", "at least one topic that is measured", "none beside inputs and truth")
    topics = read_bag(data.file, {name: data.topics[name] for name in (*names, *aside)}).topics
    begin = max((topics[name].seconds[0] for name in data.inputs), default=-np.inf)
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
    arrays = {name: line.ys[f"topic {name}"] for name in names} | {name: topics[name].held(steps) for name in data.inputs}
    arrays |= {name: topics[name].at(steps) for name in data.truth} | {TIME: steps}
    lost = next((name for name in data.truth if np.isnan(arrays[name]).all()), None)
    if lost:
        refuse(f"data {lost}", f"true states between {steps[0]:g} and {steps[-1]:g} s", "none", "Are the clocks of both topics the same?")
    return replace(data, columns=names, time=TIME), arrays
