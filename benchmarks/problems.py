"""The models in plain numbers, and one simulated record for each: every engine is given the same. NumPy only."""

import numpy as np

INTERVAL = 0.5
"""Seconds between radar measurements."""

LINE = {"a": 0.9, "q": 0.5, "r": 0.3, "mean": 0.0, "variance": 1.0}
"""1-D linear Gaussian: x' = a x + noise of variance q, y = x + noise of variance r."""

RADAR = {
    "A": np.eye(6) + INTERVAL * np.eye(6, k=2) + INTERVAL**2 / 2 * np.eye(6, k=4),
    "Q": np.array([1, 1, 1, 1, 0.01, 0.01]),
    "R": np.array([100, 1e-6]),
    "mean": np.array([300.0, 300, 5, -5, 0, 0]),
    "P": np.array([4.0, 4, 16, 16, 0.04, 0.04]),
}
"""Range and azimuth of an aircraft, six states (Karlsson, Schon, Gustafsson 2005, section IV); Q, R and P are diagonals."""

TRACK = {
    "A": np.kron(np.array([[0.95, 0.5], [0, 0.9]]), np.eye(2)),
    "Q": np.full(4, 0.1),
    "H": np.eye(2, 4),
    "R": np.full(2, 0.5),
    "mean": np.zeros(4),
    "P": np.ones(4),
}
"""Linear: two positions and two velocities with damping, positions measured; for the Kalman filters. Diagonals as above."""


RADIUS = 100.0
"""Meters; of the circle that the target of long records flies, from where the radar's does and as fast."""

PENDULUMS = {
    "substeps": 10,
    "interval": 0.1,
    "Q": np.full(4, 0.01),
    "R": np.array([0.25]),
    "mean": np.array([1.0, 2, 0.5, 0.1]),
    "P": np.full(4, 0.1),
    "table": np.random.default_rng(0).standard_normal((400, 400)),
}
"""Two damped pendulums, one driving the other, through ten substeps by Runge and Kutta; a table looked up at both angles is measured."""


def swing(angles, rates, sin, cos):
    """Accelerations of the pendulums."""
    return -sin(angles[0]) - 0.1 * rates[0], -sin(angles[1]) - 0.1 * rates[1] + 0.2 * cos(angles[0])


def substepped(x, slope):
    """Take one substep by Runge and Kutta."""
    step = PENDULUMS["interval"] / PENDULUMS["substeps"]
    k1 = slope(x)
    k2 = slope(x + step / 2 * k1)
    k3 = slope(x + step / 2 * k2)
    k4 = slope(x + step * k3)
    return x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def looked_up(x, table, whole):
    """What is measured of the pendulums."""
    return x[0] + table[whole(10 * x[0] + 200), whole(10 * x[1] + 200)]


def circled(steps):
    """Places of a target that stays, `(t, 2)`: one that follows the radar's model for long ends where float32 has no digits left."""
    place, velocity = RADAR["mean"][:2], RADAR["mean"][2:4]
    speed = np.hypot(*velocity)
    inward = np.array([-velocity[1], velocity[0]]) / speed
    angle = np.arange(steps)[:, None] * INTERVAL * speed / RADIUS
    return place + RADIUS * (np.sin(angle) * velocity / speed + (1 - np.cos(angle)) * inward)


def turned(x):
    """Rotate the velocity by an angle that depends on the position: the Kalman part then differs from particle to particle."""
    angle = 0.01 * np.tanh(x[0] / 1000) + 0.02 * np.tanh(x[1] / 1000)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    after = RADAR["A"] @ x
    after[2:4] = rotation @ after[2:4]
    return after


def measurements(model, steps, seed=5):
    """Simulate a record `(t, y)`.

    On this seed the azimuth of the radar stays far from its seam at pi, so that nobody must wrap angles, and 2 000 particles never lose the
    track, so that log likelihoods can be compared at every size.
    """
    draw = np.random.default_rng(seed).standard_normal
    if model == "line":
        move, measure = (lambda x: LINE["a"] * x), (lambda x: x)
        numbers = {name: np.array([LINE[short]]) for name, short in (("Q", "q"), ("R", "r"), ("mean", "mean"), ("P", "variance"))}
    elif model == "track":
        numbers, move, measure = TRACK, (lambda x: TRACK["A"] @ x), (lambda x: TRACK["H"] @ x)
    elif model == "pendulums":
        numbers, measure = PENDULUMS, (lambda x: np.array([looked_up(x, PENDULUMS["table"], int)]))

        def slope(x):
            return np.array([x[2], x[3], *swing(x[:2], x[2:], np.sin, np.cos)])

        def move(x):
            for _ in range(PENDULUMS["substeps"]):
                x = substepped(x, slope)
            return x

    else:
        numbers, measure = RADAR, (lambda x: np.array([np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])]))
        move = turned if model == "turning" else (lambda x: RADAR["A"] @ x)
    size, width = len(numbers["mean"]), len(numbers["R"])
    if model == "circling":
        return np.array([measure(x) + np.sqrt(numbers["R"]) * draw(width) for x in circled(steps)])
    x, ys = numbers["mean"] + np.sqrt(numbers["P"]) * draw(size), []
    for t in range(steps):
        x = x if t == 0 else move(x) + np.sqrt(numbers["Q"]) * draw(size)
        ys.append(measure(x) + np.sqrt(numbers["R"]) * draw(width))
    return np.array(ys)
