"""What Karlsson, Schon, Gustafsson (2005) print, and the errors of its count of flops on its own times."""

import numpy as np

import motes as mo

COSTS = mo.costs.Costs.paper()
KALMAN = {"PPPPPP": (), "PPKKPP": ("vx", "vy"), "PPPPKK": ("ax", "ay"), "PPKKKK": ("vx", "vy", "ax", "ay")}
"""The partitions of the paper, P for a state in particles and K for one in Kalman filters, and the states of the Kalman filters."""
PLAIN, FULL = "PPPPPP", "PPKKKK"

TABLE_II = {
    "PPPPPP": (2000, 7.10, 3.62, 0.52, 0.59),
    "PPKKPP": (2029, 5.81, 3.27, 0.47, 0.58),
    "PPPPKK": (1974, 5.76, 3.28, 0.45, 0.57),
    "PPKKKK": (2574, 5.60, 3.21, 0.44, 0.60),
}
"""Equal times: particles, RMSE of position, velocity and acceleration, time."""
TABLE_III = {
    "PPPPPP": (2393, 7.07, 3.58, 0.50, 0.73),
    "PPKKPP": (864, 6.98, 3.60, 0.51, 0.26),
    "PPPPKK": (943, 7.12, 3.65, 0.49, 0.28),
    "PPKKKK": (264, 7.27, 3.61, 0.48, 0.10),
}
"""Equal RMSE of the velocity; columns as in table II."""


def flops(partition: str, n: int, costs: mo.costs.Costs) -> float:
    """Equivalent flops of a step by equation 11."""
    k = len(KALMAN[partition])
    return mo.costs.complexity(6 - k, k, n, costs)


def own_errors() -> list[float]:
    """Errors of equation 11, with the paper's constants, on the eight times that the paper prints; the price of a flop is fitted to them.

    The price has the least squares of relative errors. That leaves the count one free number that ours do not have.
    """
    rows = [(flops(name, row[0], COSTS), row[-1]) for table in (TABLE_II, TABLE_III) for name, row in table.items()]
    shares = np.array([counted / seconds for counted, seconds in rows])
    return (shares * shares.sum() / (shares @ shares) - 1).tolist()
