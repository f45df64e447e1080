"""The most likely way and map of a recording by places, all at once: Gauss-Newton on the whole graph; an answer to hold filters against."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from motes.applications.slam import model as numbers


def solved(graph, path, places, errors, steps=25):
    """Places `(t, 2)` and landmarks `(L, 2)` of the largest posterior density, begun at a filter's answer.

    Args:
        graph: `recording.Graph`.
        path: place and heading, `(t, 3)`.
        places: landmarks, `(L, 2)`.
        errors: drift and share of turns.
        steps: of Gauss-Newton.
    """
    count = len(path)
    at = np.concatenate([path.ravel(), places.ravel(), errors])
    i = np.arange(count - 1)
    pose, seen = graph.seen[:, 0].astype(int), graph.seen[:, 1].astype(int)
    moved = graph.steps[1:]
    way = np.hypot(moved[:, 0], moved[:, 1])
    sds = np.array([numbers.AHEAD_SD, numbers.ACROSS_SD, numbers.TURN_SD])
    priors = np.array([numbers.START] * 3 + [numbers.DRIFT_SD, numbers.TURN_SHARE_SD])
    first = np.array([0, 1, 2, len(at) - 2, len(at) - 1])

    def turned(points, angle):
        return points @ [1, 1j] * np.exp(-1j * angle)

    for _ in range(steps):
        poses, marks, (drift, share) = at[: 3 * count].reshape(-1, 3), at[3 * count : -2].reshape(-1, 2), at[-2:]
        entries, residuals, base = [], [], 0

        # odometry: seen from the pose before
        apart = turned(poses[1:, :2] - poses[:-1, :2], poses[:-1, 2])
        turn = moved[:, 2] * (1 + share) + drift * way
        rest = np.stack([apart.real - moved[:, 0], apart.imag - moved[:, 1], poses[1:, 2] - poses[:-1, 2] - turn], axis=1) / sds
        c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
        for component, (by_x, by_y, by_turn) in enumerate(((c, s, apart.imag), (-s, c, -apart.real))):
            for place, sign in ((3 * (i + 1), 1), (3 * i, -1)):
                entries.append((base, 3 * i + component, place, sign * by_x / sds[component]))
                entries.append((base, 3 * i + component, place + 1, sign * by_y / sds[component]))
            entries.append((base, 3 * i + component, 3 * i + 2, by_turn / sds[component]))
        for place, value in ((3 * (i + 1) + 2, 1.0), (3 * i + 2, -1.0), (len(at) - 2, -way), (len(at) - 1, -moved[:, 2])):
            entries.append((base, 3 * i + 2, place, value / sds[2]))
        residuals.append(rest.ravel())
        base += 3 * (count - 1)
        # sightings, those that fit badly count little (Cauchy)
        apart = turned(marks[seen] - poses[pose, :2], poses[pose, 2])
        rest = np.stack([apart.real - graph.seen[:, 2], apart.imag - graph.seen[:, 3]], axis=1) / numbers.PLACE_SD
        weight = 1 / np.sqrt(1 + (rest**2).sum(axis=1) / 16)
        c, s, j = np.cos(poses[pose, 2]), np.sin(poses[pose, 2]), np.arange(len(pose))
        for component, (by_x, by_y, by_turn) in enumerate(((c, s, apart.imag), (-s, c, -apart.real))):
            for place, sign in ((3 * count + 2 * seen, 1), (3 * pose, -1)):
                entries.append((base, 2 * j + component, place, sign * by_x * weight / numbers.PLACE_SD))
                entries.append((base, 2 * j + component, place + 1, sign * by_y * weight / numbers.PLACE_SD))
            entries.append((base, 2 * j + component, 3 * pose + 2, by_turn * weight / numbers.PLACE_SD))
        residuals.append((rest * weight[:, None]).ravel())
        base += 2 * len(pose)
        entries.append((base, np.arange(5), first, 1 / priors))
        residuals.append(at[first] / priors)
        base += 5
        whole = [np.broadcast_arrays(row + before, column, value) for before, row, column, value in entries]
        rows, columns, values = (np.concatenate(part) for part in zip(*whole, strict=True))
        J = coo_matrix((values, (rows, columns)), (base, len(at))).tocsc()
        step = spsolve(J.T @ J, -J.T @ np.concatenate(residuals))
        at = at + step
        if np.abs(step).max() < 1e-6:
            break
    return at[: 3 * count].reshape(-1, 3)[:, :2], at[3 * count : -2].reshape(-1, 2)
