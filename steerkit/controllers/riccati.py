"""What a deviation costs from now to infinity: a Riccati solution, which LQR and MPC design with at every speed.

Solutions are remembered within the process. Controllers are made again and again for the same cars: for every drive of
a table, for every delay that an adaptive one is prepared for; a controller's tables are some hundred solutions.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cost_to_go(a: Array, b: Array, q: Array, r: float) -> Array:
    """P (n, n) of x' P x, the sum of x' Q x + r u^2 from now on with the best feedback and without limits.

    x+ = A x + B u,  P = Q + A' P A - A' P B (r + B' P B)^-1 B' P A

    a (n, n), b (n,), q (n, n), r > 0: the matrices A, B, Q and r. Raises LinAlgError or ValueError for a system that no
    feedback makes stable. Source: Anderson, Moore 1990, ch. 2.
    """
    parts = [np.ascontiguousarray(part, dtype=float) for part in (a, b, q)]
    return np.frombuffer(_solution(*[part.tobytes() for part in parts], float(r))).reshape(parts[0].shape).copy()


@lru_cache(maxsize=2048)
def _solution(a: bytes, b: bytes, q: bytes, r: float) -> bytes:
    from scipy.linalg import solve_discrete_are

    column: Any = np.frombuffer(b)[:, None]
    n = len(column)
    p = solve_discrete_are(np.frombuffer(a).reshape(n, n), column, np.frombuffer(q).reshape(n, n), np.array([[r]]))
    return np.ascontiguousarray(p, dtype=float).tobytes()
