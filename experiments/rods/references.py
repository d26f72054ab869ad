"""What the rods are measured by: boundary-value problems of Kirchhoff's rod, solved by `solve_bvp`.

Nothing of the package is used. Units and clamped root as in `cases`.
"""

from collections.abc import Callable, Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

Array = NDArray[np.float64]
BEAM_ROOT = 1.8751040687119611  # the first root of cos x cosh x = −1
ROUGH, TIGHT = 1e-5, 1e-9  # relative residuals of `solve_bvp`; the second gives errors of 1e-11


def bending_frequency() -> float:
    """Lowest angular frequency of the Euler–Bernoulli cantilever."""
    return BEAM_ROOT**2


def twist_frequency(poisson: float, radius: float) -> float:
    """Lowest angular frequency of a free shaft, `pi/L sqrt(G/rho)`."""
    return np.pi * np.sqrt(2 / (1 + poisson)) / radius


def _solve(rates, ends, guess, tolerance: float = TIGHT):
    """`solve_bvp` from a guess: another solution, or values (n, m) on an even mesh."""
    s, y = (guess.x, guess.y) if hasattr(guess, "x") else (np.linspace(0, 1, guess.shape[1]), guess)
    solution = solve_bvp(rates, ends, s, y, tol=tolerance, max_nodes=200_000)
    if not solution.success:
        raise RuntimeError(solution.message)
    return solution


def elastica(weights: Array, s: Array) -> Array:
    """Points (k, m, 3) of the heavy cantilever: `phi'' = −Gamma (1 − s) cos phi`, phi downwards from x."""
    guess, shapes = np.zeros((4, 101)), []
    for weight in weights:

        def rates(s, y, weight=weight):
            return np.array([y[1], weight * (s - 1) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

        guess = _solve(rates, lambda a, b: np.array([a[0], b[1], a[2], a[3]]), guess)
        x, z = guess.sol(s)[2:]
        shapes.append(np.column_stack([x, 0 * x, -z]))
    return np.array(shapes)


def kirchhoff(curvature: Array, gravity: Array, twist_stiffness: float, s: Array, stages: int = 8) -> Array:
    """Points (m, 3) of a naturally curved heavy rod, by continuation in its weight from its natural shape.

    Unknown are the position, the frame F and the curvature in material axes; the moment is
    `K (kappa − kappa⁰)` and the force `(1 − s) gravity`, the weight of what hangs below.
    """
    K, rest = np.array([twist_stiffness, 1.0, 1.0])[:, None], np.asarray(curvature, dtype=float)[:, None]

    def rates(s, y, weight):
        F, kappa = y[3:12].reshape(3, 3, -1), y[12:]
        force = np.einsum("ija,i->ja", F, weight) * (1 - s)
        t_x_force = np.array([0 * s, -force[2], force[1]])
        moment_rate = -np.cross(kappa, K * (kappa - rest), axis=0) - t_x_force
        turned = np.cross(F, kappa[None], axis=1)  # a row times [kappa]×
        return np.concatenate([F[:, 0], turned.reshape(9, -1), moment_rate / K])

    def ends(a, b):
        return np.concatenate([a[:3], a[3:12] - np.eye(3).ravel(), b[12:] - rest[:, 0]])

    start = np.concatenate([np.zeros(3), np.eye(3).ravel(), rest[:, 0]])
    zero = np.zeros(3)
    natural = solve_ivp(
        lambda s, y: rates(np.array([s]), y[:, None], zero)[:, 0], (0, 1), start,
        t_eval=np.linspace(0, 1, 101), rtol=1e-10, atol=1e-12,
    ).y  # fmt: skip
    solution = natural
    for share in np.linspace(0, 1, stages + 1)[1:]:
        weight, tolerance = share * np.asarray(gravity), TIGHT if share == 1 else ROUGH
        solution = _solve(lambda s, y, weight=weight: rates(s, y, weight), ends, solution, tolerance)
    return solution.sol(s)[:3].T


class Hook:
    """The plane equilibria of a hanging rod of natural curvature `bend` about n_1, and when they buckle.

    The tangent turns by phi from the vertical: `phi'' = Gamma (1 − s) sin phi`, `phi'(1) = bend`. Out of the
    plane a small rotation `w = (w_t, w_2)` of the frame and the moments `m = (m_t, m_2)` it causes obey, with
    `k = phi'`, the moment `M = k − bend` and the force `(f_t, f_2) = Gamma (1 − s) (cos phi, sin phi)`,

        w_t' = m_t/GJ − k w_2,            w_2' = m_2 + k w_t,
        m_t' = M m_2 − k m_2,             m_2' = k m_t − M m_t/GJ + w_2 f_t − w_t f_2,

    `w(0) = 0, m(1) = 0`: Kirchhoff's equations linearised about the plane solution. The plane loses its
    stability where they have a solution, that is where the determinant of m(1) as a function of m(0) is zero.
    """

    def __init__(self, bend: float, twist_stiffness: float) -> None:
        self.bend, self.twist_stiffness = bend, twist_stiffness

    def curl(self, weight: float):
        """Plane equilibrium of the branch that begins at the natural arc, with growing weight."""
        s, shares = np.linspace(0, 1, 201), np.linspace(0, 1, 11)[1:]
        arc = np.array([self.bend * s, self.bend + 0 * s])
        return self._follow(zip(shares * weight, np.full(10, self.bend), strict=True), arc)

    def hanging(self, weight: float):
        """Plane equilibrium of the branch that begins at the straight rod, with growing natural curvature."""
        shares = np.linspace(0, 1, 11)[1:]
        return self._follow(zip(np.full(10, weight), shares * self.bend, strict=True), np.zeros((2, 201)))

    def _follow(self, path, solution):
        for weight, bend in path:
            problem = (
                lambda s, y, weight=weight: np.array([y[1], weight * (1 - s) * np.sin(y[0])]),
                lambda a, b, bend=bend: np.array([a[0], b[1] - bend]),
            )
            solution = _solve(*problem, solution, ROUGH)
        return _solve(*problem, solution)

    def determinant(self, weight: float, plane) -> float:
        """Determinant of m(1) as a function of m(0)."""
        GJ = self.twist_stiffness

        def rates(s, y):
            phi, k = plane.sol(s)
            M, f_t, f_2 = k - self.bend, weight * (1 - s) * np.cos(phi), weight * (1 - s) * np.sin(phi)
            w_t, w_2, m_t, m_2 = y.reshape(4, 2)
            return np.concatenate(
                [m_t / GJ - k * w_2, m_2 + k * w_t, (M - k) * m_2, (k - M / GJ) * m_t + w_2 * f_t - w_t * f_2]
            )

        start = np.vstack([np.zeros((2, 2)), np.eye(2)]).ravel()
        end = solve_ivp(rates, (0, 1), start, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        return float(np.linalg.det(end.reshape(4, 2)[2:]))

    def transition(self, branch: str) -> float:
        """Weight at which the plane equilibria of a branch lose their stability."""
        find, start, factor = {
            "curl": (self.curl, 4.0, 1.15),
            "hanging": (self.hanging, 0.4 * self.bend**3, 0.85),
        }[branch]
        return first_zero(lambda weight: self.determinant(weight, find(weight)), start, factor)


def first_zero(function: Callable[[float], float], start: float, factor: float, steps: int = 40) -> float:
    """First zero of a function that is positive at `start`, on the way through `start factor^k`."""
    a = start
    if not function(a) > 0:
        raise RuntimeError(f"the function is not positive at {start}")
    for _ in range(steps):
        a, b = a * factor, a
        if function(a) < 0:
            return brentq(function, min(a, b), max(a, b), xtol=1e-10, rtol=1e-10)
    raise RuntimeError("no zero was found")


class DraggedRod:
    """The plane elastica pressed on a floor and dragged along it: the tip sticks, then slips.

    A weightless rod of natural curvature `bend` is clamped with its tangent `dip` below the x axis, so that
    its natural shape touches the floor. The clamp goes down by `depth`, then back by d. While the tip sticks it is a
    hinge: with the angle phi below the x axis and the floor's force (−T, N) on the tip,

        phi'' = N cos phi − T sin phi,   phi(0) = dip,   phi'(1) = bend,

    and the place of the tip gives T and N. It slips when T/N reaches mu.
    """

    def __init__(self, dip: float, bend: float, depth: float) -> None:
        self.dip, self.bend = dip, bend
        s = np.linspace(0, 1, 101)
        phi = dip + bend * s
        self._natural = np.array([phi, 0 * s + bend, self._along(s)[0], self._along(s)[1]])
        self._floor = self._natural[3, -1] - depth

    def _along(self, s: Array) -> Array:
        """Natural shape, an arc: x forwards and z downwards."""
        a, b = self.dip, self.dip + self.bend * s
        return np.array([np.sin(b) - np.sin(a), np.cos(a) - np.cos(b)]) / self.bend

    @cached_property
    def forces(self) -> CubicSpline:
        """T and N (m, 2) as a function of distances up to 0.4."""
        drags = np.linspace(0, 0.4, 81)
        return CubicSpline(drags, [force for _, force in self.follow(drags)])

    def onset(self, mu: Array) -> Array:
        """Distances at which the tip slips, for coefficients that T/N grows to."""
        drags = self.forces.x
        T, N = self.forces(drags).T
        return CubicSpline(T / N, drags)(mu)

    def follow(self, drags: Array) -> Iterator[tuple[Array, Array]]:
        """Values (4, 101) of phi, its slope, x and z along the rod, and (T, N), at growing distances d."""
        touch = self._natural[3, -1]
        pressing = [(0.0, touch + share * (self._floor - touch)) for share in np.linspace(0.04, 1, 25) ** 2]
        shape, force = self._natural, np.zeros(2)
        for k, (d, floor) in enumerate([*pressing, *((d, self._floor) for d in drags)]):
            shape, force = self._balance(shape, force, self._natural[2, -1] + d, floor)
            if k >= len(pressing):
                yield shape, force

    def _balance(self, guess: Array, force: Array, x: float, z: float) -> tuple[Array, Array]:
        """Values (4, 101) and (T, N) with the tip at a place, from those at a place near it."""
        s = np.linspace(0, 1, 101)
        solution = solve_bvp(
            lambda s, y, p: np.array(
                [y[1], p[1] * np.cos(y[0]) - p[0] * np.sin(y[0]), np.cos(y[0]), np.sin(y[0])]
            ),
            lambda a, b, p: np.array([a[0] - self.dip, a[2], a[3], b[1] - self.bend, b[2] - x, b[3] - z]),
            s,
            guess,
            p=force,
            tol=TIGHT,
            max_nodes=200_000,
        )
        if not solution.success:
            raise RuntimeError(solution.message)
        return solution.sol(s), solution.p


def string_on_a_drum(root: float, hanging: float, weight: float, mu: float, phi: float) -> float:
    """The ratio `exp(mu phi)` seen by a heavy string that slips on a drum of radius 1, from its two tensions.

    The string hangs from the angle 0 (its tension there is `hanging`) and meets the drum at phi, under the
    tension `root`; its weight is `weight` a unit length. At the angle beta, with friction towards the hanging end,

        T' = mu T + weight (cos beta + mu sin beta),    T = C exp(mu beta) + A sin beta + B cos beta.
    """
    A = weight * (1 - mu**2) / (1 + mu**2)
    B = -2 * mu * weight / (1 + mu**2)
    return float((root - A * np.sin(phi) - B * np.cos(phi)) / (hanging - B))
