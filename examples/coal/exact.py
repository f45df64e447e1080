"""The exact posterior of change points of yearly counts with gamma rates, by dynamic programming over the years."""

import numpy as np
from scipy.special import gammaln, logsumexp


def log_marginals(counts):
    """Log probability `(i, j)` of the counts of years i to j - 1 at one rate with the law Gamma(1, 1 per year)."""
    n = len(counts)
    sums, facts = np.append(0, np.cumsum(counts)), np.append(0, np.cumsum(gammaln(np.asarray(counts) + 1.0)))
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    total, years = sums[j] - sums[i], j - i
    with np.errstate(invalid="ignore", divide="ignore"):
        found = gammaln(total + 1.0) - (total + 1) * np.log(years + 1.0) - (facts[j] - facts[i])
    return np.where(years > 0, found, -np.inf)


def exact(counts, log_prior):
    """Return the probabilities of 0, 1, ... changes, and those of the first change after year 1, 2, ... (none: not counted).

    Args:
        counts: of n years.
        log_prior: log probability of each number of changes; places among the n - 1 between years are uniform.
    """
    n, most = len(counts), len(log_prior) - 1
    one = log_marginals(counts)
    # rest[k][i]: log of the sum over all places of k changes of the probability of the counts from year i on
    rest = [one[:, n]]
    for _ in range(most):
        rest.append(logsumexp(one[:, 1:n] + rest[-1][None, 1:n], axis=1))
    ways = np.array([gammaln(n) - gammaln(k + 1) - gammaln(n - k) for k in range(most + 1)])
    joint = np.asarray(log_prior) + np.array([rest[k][0] for k in range(most + 1)]) - ways
    first = logsumexp(np.stack([log_prior[k] - ways[k] + one[0, 1:n] + rest[k - 1][1:n] for k in range(1, most + 1)]), axis=0)
    total = logsumexp(joint)
    return np.exp(joint - total), np.exp(first - total)
