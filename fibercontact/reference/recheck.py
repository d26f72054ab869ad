"""The re-check of certificates that a solution exists, or that none does (THEORY §5).

Plain numpy and scipy.sparse: it shares no line with the code that makes certificates. What it returns is proved in
spite of rounding: each quantity is moved by a bound on its own error, against the claim. A sum of m products, in any
order, is off by at most `m eps` times the sum of their absolute values [Higham 2002, section 3.1], and by less than
the least normal number for each product that underflows; twice that and a little more is taken, which covers the
rounding of the bound itself. Where something overflows nothing is proved.

References: [Acary, Cadoux, Lemaréchal & Malick 2011] ZAMM 91; [Higham 2002] Accuracy and stability of numerical
algorithms.
"""

from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array, issparse

__all__ = ["solvable_slack", "unsolvable_radius"]

Array = NDArray[np.float64]

EPS, TINY, HUGE = (float(getattr(np.finfo(np.float64), name)) for name in ("eps", "tiny", "max"))


def solvable_slack(W: Any, b: ArrayLike, mu: ArrayLike, z: ArrayLike) -> float:
    """Prove that a solution exists: a lower bound of `min_i (u_N,i - mu_i ‖u_T,i‖)` at `u = W z + b`.

    Positive: `u` is in the interior of every `K_mu*`, so that Coulomb's law has a solution for symmetric positive
    semidefinite `W`. Not positive: `z` proves nothing. In units of `b_ref = sqrt(mean_i ‖b_i‖²)`, in m/s where that
    is zero (or no normal floating-point number).

    `W` (3n, 3n) is dense, or sparse of any format; `b` and `z` have shape (3n,), `mu` (n,). Raises `ValueError` on
    other shapes, on numbers that are not finite, and on a negative `mu`.
    """
    W, b = _matrix(W), _vector("b", b)
    mu, z = _vector("mu", mu), _vector("z", z)
    _check_shapes(W, b=b.size, z=z.size, mu=3 * mu.size)
    if (mu < 0.0).any():
        raise ValueError("mu must not be negative")
    with np.errstate(all="ignore"):
        u, error = (x.reshape(-1, 3).T for x in _affine(W, z, b))
        friction = mu * np.hypot(np.abs(u[1]) + error[1], np.abs(u[2]) + error[2])
        slack = u[0] - error[0] - friction
        slack -= 16 * EPS * (np.abs(u[0]) + error[0] + friction) + TINY
        least, scale = float(np.min(slack, initial=HUGE)), _root_mean_square(_norms(b))
        relative = _lowered(least / scale, b.size) if scale >= TINY else least
    return -np.inf if np.isnan(relative) else min(relative, HUGE)


def unsolvable_radius(W: Any, b: ArrayLike, r: ArrayLike) -> float:
    """Prove that no solution exists, or no small one: the radius of a ball of impulses without a solution.

    Theorem. Let `r_N >= 0`, `r_T = 0`, `bᵀr < 0` and `g = Wᵀr`. Any solution `z` has `(W z + b)_N >= 0`, hence

        0 <= rᵀ(W z + b) = gᵀz + bᵀr,   so   |bᵀr| <= gᵀz <= sqrt(Σ_i ‖g_i‖² / sigma_i²) · sqrt(Σ_i sigma_i² ‖z_i‖²)

    with `sigma_i = trace(W_ii)/3`, and so

        sqrt(mean_i (sigma_i ‖z_i‖)²) >= |bᵀr| / sqrt(n Σ_i ‖g_i‖² / sigma_i²).

    The right-hand side, in units of `b_ref = sqrt(mean_i ‖b_i‖²)`, is returned, rounded down. Infinite: `W r` is
    exactly zero (Farkas), there is no solution. 1e8, say: impulses would have to be 1e8 times those that stop the
    free velocities. Zero: `r` is no certificate; an `r_N` is negative, an `r_T` is not zero, or `bᵀr` is not below
    zero by more than its rounding.

    `W` (3n, 3n) is dense, or sparse of any format; `b` and `r` have shape (3n,). Raises `ValueError` on other shapes
    and on numbers that are not finite.
    """
    W, b, r = _matrix(W), _vector("b", b), _vector("r", r)
    _check_shapes(W, b=b.size, r=r.size)
    if (r[::3] < 0.0).any() or r[1::3].any() or r[2::3].any():
        return 0.0
    with np.errstate(all="ignore"):
        gain = -(b @ r) - _rounding(b.size, np.abs(b) @ np.abs(r))
        relative = _lowered(gain / max(_root_mean_square(_norms(b)), TINY), b.size)
        g = _norms(_largest(csr_array(W.T), r))
        sigma, moves = W.diagonal().reshape(-1, 3).sum(axis=1) / 3.0, g > 0.0
        if not relative > 0.0 or (sigma[moves] <= 0.0).any():
            return 0.0
        if not moves.any():
            return np.inf
        ratio = np.divide(g, sigma, out=np.zeros_like(g), where=moves)
        dual = ratio.size * _root_mean_square(ratio)
        return max(0.0, min(_lowered(relative / max(dual, TINY), b.size), HUGE))


def _affine(W: csr_array, z: Array, b: Array) -> tuple[Array, Array]:
    """`W z + b`, and a bound on the rounding error of each component."""
    return W @ z + b, _rounding(np.diff(W.indptr) + 1, abs(W) @ np.abs(z) + np.abs(b))


def _largest(W: csr_array, r: Array) -> Array:
    """Upper bounds of `|W r|`, zero where `W r` is exactly zero: rows that sum to zero are added as fractions."""
    g, error = _affine(W, r, np.zeros(r.size))
    for k in np.flatnonzero(g == 0.0):
        row = slice(W.indptr[k], W.indptr[k + 1])
        entries = zip(W.data[row], W.indices[row], strict=True)
        if sum(Fraction(w) * Fraction(r[j]) for w, j in entries if r[j] != 0.0) == 0:
            error[k] = 0.0
    return np.abs(g) + error


def _rounding(terms: Any, sizes: Any) -> Any:
    """Bound on the rounding error of a sum of products, from the sum of their absolute values as computed."""
    return 2 * (terms + 2) * EPS * sizes + terms * TINY


def _lowered(quotient: float, terms: int) -> float:
    """A lower bound of what is computed as `quotient`, over the root of a sum of so many squares."""
    doubt = (terms + 32) * EPS
    return float(quotient * (1.0 - doubt if quotient > 0.0 else 1.0 + doubt) - TINY)


def _norms(x: Array) -> Array:
    """Norms of the triples of `x` (3n,)."""
    return np.hypot(np.hypot(x[::3], x[1::3]), x[2::3])


def _root_mean_square(x: Array) -> float:
    """`sqrt(mean x²)`, zero for no numbers; the squares neither overflow nor vanish together."""
    largest = np.max(np.abs(x), initial=0.0)
    return float(largest * np.sqrt(np.mean((x / largest) ** 2))) if largest > 0.0 else 0.0


def _matrix(W: Any) -> csr_array:
    """A copy in CSR, entries that are stored twice added."""
    sparse: bool = issparse(W)
    rows = W.tocsr(copy=True).astype(np.float64) if sparse else csr_array(_finite("W", W))
    rows.sum_duplicates()
    _finite("W", rows.data)
    return rows


def _vector(name: str, x: ArrayLike) -> Array:
    x = _finite(name, x)
    if x.ndim != 1:
        raise ValueError(f"{name} must have one dimension, not {x.ndim}")
    return x


def _finite(name: str, x: ArrayLike) -> Array:
    x = np.asarray(x, dtype=np.float64)
    if not np.isfinite(x).all():
        raise ValueError(f"{name} must be finite")
    return x


def _check_shapes(W: csr_array, **sizes: int) -> None:
    """`sizes` are what W's should be by each of the vectors."""
    rows = W.shape[0]
    if W.ndim != 2 or W.shape != (rows, rows) or rows % 3:
        raise ValueError(f"W must have shape (3n, 3n), not {W.shape}")
    for name, size in sizes.items():
        if size != rows:
            raise ValueError(f"{name} must go with the {rows // 3} contacts of W")
