"""The convex problem of a fixed slip term `s`, solved by Clarabel as a second-order cone programme (THEORY §5).

    in impulses    min ½ rᵀW r + (b + mu s e)ᵀr    s.t. r ∈ K_mu
    in velocities  min ½ vᵀM v + fᵀv               s.t. H v + w + mu s e ∈ K_mu*

are dual to each other; `s = 0` is the *associated* model, a law of its own and not Coulomb's. Two scalings
come first, or Clarabel stops early: velocities are divided by `beta`, and with `S = diag(1, mu, mu) / sqrt(sigma)`
a contact, `r = beta S z` and `S ũ / beta` lie in the Lorentz cone, where `mu = 0` needs no care.

References: [Cadoux 2009]; [Acary, Cadoux, Lemaréchal & Malick 2011] ZAMM 91.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csc_matrix, diags_array, eye_array, triu

from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.step import StepProblem

__all__ = [
    "ConvexAnswer",
    "ConvexModel",
    "Form",
    "Problem",
    "associated",
    "condensed",
    "default_form",
    "duality_gap",
    "impulse_form",
    "sharp_form",
    "solve_convex",
    "tight_form",
    "velocity_form",
]

Array = NDArray[np.float64]
Problem = IncrementalProblem | StepProblem


DEFAULT = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-12)
TIGHT = dict.fromkeys(DEFAULT, 1e-13)
SHARP = TIGHT | {
    "static_regularization_constant": 1e-12,
    "iterative_refinement_max_iter": 50,
    "iterative_refinement_reltol": 1e-15,
    "iterative_refinement_abstol": 1e-15,
}
"""Clarabel's settings. Tighter ones get further on some problems and stop early on others."""


class Program(NamedTuple):
    """`min ½ xᵀP x + (q + g)ᵀx  s.t. A x + h + g' ∈ Lorentz cones`; the slip term enters as `g` or as `g'`."""

    P: csc_array
    q: Array
    A: csc_array
    h: Array
    impulse: bool  # True: x is z and the slip term is g; False: z is the multiplier and the slip term is g'


@dataclass(frozen=True)
class ConvexAnswer:
    """Impulses `r` (3n,) in N·s, Clarabel's status, and the duality gap in J."""

    r: Array
    status: str
    gap: float


def condensed(problem: Problem) -> IncrementalProblem:
    """The problem in impulses."""
    return problem.condense() if isinstance(problem, StepProblem) else problem


class ConvexModel:
    """The convex problem laid out for one slip term after the other: only a vector changes between them.

    Built by `velocity_form`, `impulse_form` or `sharp_form`. `S` (3n,) and `beta` are the scaling of the module's
    docstring.
    """

    def __init__(
        self, program: Program, mu: Array, S: Array, beta: float, settings: Mapping[str, float] = DEFAULT
    ) -> None:
        self.program, self.mu, self.S, self.beta, self.settings = program, mu, S, beta, settings
        self.solver: Any = None

    def solve(self, s: Array, max_seconds: float = math.inf) -> ConvexAnswer:
        """Solve for the slip term `s` (n,) >= 0 in m/s. Impulses of a failed solve may be bad or not finite."""
        return self.solve_shifted(self.mu * s, max_seconds)

    def solve_shifted(self, shift: Array, max_seconds: float = math.inf) -> ConvexAnswer:
        """Solve for any normal velocity `shift` (n,) in m/s in the place of `mu s`, negative ones too.

        Without a feasible velocity `r` is a Farkas certificate: in the cones, `Hᵀ r = 0`, `(b + shift)ᵀ r < 0`.
        """
        normal = np.zeros_like(self.S)
        normal[::3] = shift * self.S[::3] / self.beta
        p = self.program
        q, h = (p.q + normal, p.h) if p.impulse else (p.q, p.h + normal)
        if self.solver is None:
            cones = [clarabel.SecondOrderConeT(3)] * len(self.mu)
            P, A = csc_matrix(triu(p.P)), csc_matrix(-p.A)
            self.solver = clarabel.DefaultSolver(P, q, A, h, cones, _settings(max_seconds, self.settings))
        else:
            self.solver.update(q=q, b=h, settings=_settings(max_seconds, self.settings))
        found = self.solver.solve()
        z = np.array(found.x if p.impulse else found.z)
        gap = self.beta**2 * abs(found.obj_val - found.obj_val_dual)
        return ConvexAnswer(self.beta * self.S * z, str(found.status), gap)


Form = Callable[[Problem], ConvexModel]


def velocity_form(problem: Problem) -> ConvexModel:
    """The problem in velocities, sparse as `M` and `H` are; raises `TypeError` when they are not at hand."""
    if not isinstance(problem, StepProblem):
        raise TypeError(
            "the velocity form needs a StepProblem: an IncrementalProblem does not know its velocities"
        )
    S, beta = _scaling(problem.condense())
    to_unit_mass = problem.M.diagonal() ** -0.5
    scale, rows = diags_array(to_unit_mass), diags_array(S)
    P, A = scale @ problem.M @ scale, rows @ problem.H @ scale
    q, h = to_unit_mass * problem.f / beta, S * problem.w / beta
    return ConvexModel(Program(P.tocsc(), q, A.tocsc(), h, False), problem.mu, S, beta)


def impulse_form(problem: Problem) -> ConvexModel:
    """The problem in impulses; `W` may be rank deficient."""
    incremental = condensed(problem)
    S, beta = _scaling(incremental)
    P = diags_array(S) @ incremental.W.tocsr() @ diags_array(S)
    program = Program(
        P.tocsc(), S * incremental.b / beta, eye_array(len(S), format="csc"), np.zeros(len(S)), True
    )
    return ConvexModel(program, incremental.mu, S, beta)


def sharp_form(problem: Problem) -> ConvexModel:
    """The problem in impulses with hardly any regularisation of Clarabel's linear systems.

    Its default, 1e-8, hides the lower end of a spectrum that spreads over ten decades; without it the solver gets
    further on such problems, and stops early on some others.
    """
    form = impulse_form(problem)
    return ConvexModel(form.program, form.mu, form.S, form.beta, SHARP)


def tight_form(problem: Problem) -> ConvexModel:
    """The default form, asked for a digit more."""
    form = default_form(problem)
    return ConvexModel(form.program, form.mu, form.S, form.beta, TIGHT)


def default_form(problem: Problem) -> ConvexModel:
    """In velocities where they are known, in impulses otherwise."""
    return velocity_form(problem) if isinstance(problem, StepProblem) else impulse_form(problem)


def solve_convex(problem: Problem, s: Array, form: Form = default_form) -> ConvexAnswer:
    """Solve the convex problem of the slip term `s` (n,) >= 0, in m/s.

    Raises `ValueError` on a slip term of the wrong shape, negative or not finite.
    """
    if s.shape != (problem.n,) or not (np.isfinite(s) & (s >= 0)).all():
        raise ValueError(f"s must be {problem.n} finite numbers >= 0")
    return form(problem).solve(s)


def associated(problem: Problem, bar: float = 1e-10) -> ConvexAnswer:
    """Solve the associated (convexified) model, `s = 0`: `K_mu* ∋ u ⟂ r ∈ K_mu`, which is not Coulomb's law.

    In velocities where they are known, in the other forms too while the duality gap is above `bar` (see
    `duality_gap`): the answer with the least gap.
    """
    incremental, none = condensed(problem), np.zeros(problem.n)
    answers = [solve_convex(problem, none)]
    for form in (impulse_form, tight_form, sharp_form):
        if duality_gap(incremental, answers[-1].r) > bar:
            answers.append(solve_convex(problem, none, form))
    return min(answers, key=lambda answer: duality_gap(incremental, answer.r))


def duality_gap(problem: IncrementalProblem, r: Array) -> float:
    """How far the impulses `r` (3n,) are from optimal in the associated model, relative to `½ rᵀW r`, the energy.

    The larger of `|rᵀu|`, which is the gap if `u ∈ K_mu*` and `r ∈ K_mu`, and of the work `r_N·violation` by which
    u leaves those cones; infinite when not finite.
    """
    u = problem.W @ r + problem.b
    outside = np.maximum(problem.mu * np.hypot(u[1::3], u[2::3]) - u[::3], 0.0)
    work = max(abs(float(r @ u)), float(np.abs(r[::3]) @ outside))
    energy = 0.5 * float(r @ (u - problem.b))
    gap = work / energy if energy > 0.0 else work
    return gap if math.isfinite(gap) else math.inf


def _scaling(problem: IncrementalProblem) -> tuple[Array, float]:
    """`S` (3n,) and `beta`: unit `sigma` at every contact and unit `b_ref`."""
    to_unit_sigma = np.repeat(problem.sigma**-0.5, 3)
    beta = np.linalg.norm(to_unit_sigma * problem.b) / math.sqrt(max(problem.n, 1))
    friction = np.column_stack([np.ones(problem.n), problem.mu, problem.mu]).ravel()
    return to_unit_sigma * friction, float(beta) or 1.0


def _settings(max_seconds: float, special: Mapping[str, float]) -> Any:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.presolve_enable = False  # it forbids updates
    settings.max_threads = 1
    settings.time_limit = max_seconds
    for name, value in special.items():
        setattr(settings, name, value)
    return settings
