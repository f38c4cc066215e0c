"""The sparse arithmetic of covariances against that of whole matrices."""

import numpy as np
import pytest

from steerkit.estimators.kalman import corrected, covariance, line, packed, predict_covariance, unpacked, widened

N, MOVING = 5, 3
rng = np.random.default_rng(3)
ROOT = rng.normal(size=(N, N))
P = ROOT @ ROOT.T
UPPER = tuple(P[np.triu_indices(N)].tolist())
MEAN = rng.normal(size=N).tolist()


def whole(entries: tuple[float, ...]) -> np.ndarray:
    upper = np.zeros((N, N))
    upper[np.triu_indices(N)] = entries
    return upper + np.triu(upper, 1).T


def test_it_is_packed_as_its_upper_triangle() -> None:
    p = unpacked(UPPER, N)
    assert packed(p) == UPPER
    assert [line(p, i) for i in range(N)] == P.tolist()
    assert covariance(p, (0, 3), (1, 4)) == pytest.approx(P[0, 1] + P[0, 4] + P[3, 1] + P[3, 4])


def test_it_is_carried_by_sparse_rows_above_a_diagonal() -> None:
    rows = [{0: 1.0, 1: 0.3, 4: -0.2}, {1: 0.8, 2: 0.1}, {0: 0.5, 2: 1.1, 3: 0.7}]
    f = np.diag([0.0, 0.0, 0.0, 0.9, 0.5])
    for i, row in enumerate(rows):
        f[i, list(row)] = list(row.values())
    after = predict_covariance(unpacked(UPPER, N), rows, [0.9, 0.5], {1: 0.4, 4: 0.2})
    assert whole(packed(after)) == pytest.approx(f @ P @ f.T + np.diag([0.0, 0.4, 0.0, 0.0, 0.2]))


def test_a_sum_of_states_is_measured() -> None:
    h = np.array([1.0, 0.0, 0.0, 1.0, 0.0])
    gain = P @ h / (h @ P @ h + 0.3)
    mean, after = corrected(MEAN, unpacked(UPPER, N), (0, 3), 0.7, 0.3, True)
    assert mean == pytest.approx(np.array(MEAN) + 0.7 * gain)
    assert whole(packed(after)) == pytest.approx((np.eye(N) - np.outer(gain, h)) @ P)


def test_what_is_not_used_changes_nothing() -> None:
    mean, after = corrected(MEAN, unpacked(UPPER, N), (0, 3), float("nan"), 0.3, False)
    assert mean == MEAN
    assert packed(after) == UPPER


def test_it_is_widened_on_the_diagonal() -> None:
    wider = whole(packed(widened(unpacked(UPPER, N), {1: 2.0, 4: 3.0})))
    assert wider - P == pytest.approx(np.diag([0.0, 2.0, 0.0, 0.0, 3.0]), abs=1e-12)
