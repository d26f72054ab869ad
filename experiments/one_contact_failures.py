"""What happens where the local solvers fail on one contact: the evidence behind docs/one_contact.md.

The visits are replayed, those with condition numbers above 1e10 apart, and the synthetic contacts with condition
numbers up to there. Of each solver's failures, up to --sample of a kind are run again iteration by iteration. Of all:
how many different operators W they have, and how many of the answers were right though the solver did not claim them.
Of

* PAC, whether its full steps end in a cycle, how long it is, and whether it is the one between take-off and a
  sticking impulse that pulls: from r = 0 the trial point is in the friction disc, so the step lands on -W⁻¹b; its
  normal part is negative, so the next step lands on 0;
* DAC, whether its line search ends at the kink between stick and slip, `|z_T| = mu z_N` to 1e-3;
* MFB, whether its Jacobian is nearly singular at the last iterate (ratio of singular values below 1e-3), and the
  coupling `mu |W_NT| / W_NN` of normal and tangents; both at its successes too;
* the two quartics, how small the root is beside the largest root of its quartic, and their errors relative to that.

    python experiments/one_contact_failures.py [--set problems/one_contact.h5] [--sample 2000] [--out FILE.csv]
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from common.script import options, write_table

from fibercontact.bench.contact_verdict import judge, tolerances
from fibercontact.local.alart_curnier import alart_curnier, steps
from fibercontact.local.algebra import eliminate_normal, solve3
from fibercontact.local.contract import Status
from fibercontact.local.fischer_burmeister import modified_fischer_burmeister
from fibercontact.local.newton import ARMIJO, SHORTEST_STEP, Contact, scaled
from fibercontact.local.one_contact import OneContacts, read, replay
from fibercontact.local.registry import configure, registered
from fibercontact.local.slip_quartic import alpha_unit, closed_roots, companion_roots, slip_quartic

CYCLES = 24
CLOSE = 1e-3


def of_kind(contacts: OneContacts) -> dict[str, np.ndarray]:
    """Masks: visits of Gauss–Seidel runs, those with singular W apart, and synthetic contacts with regular W."""
    known, regular = np.char.startswith(contacts.family, "known"), contacts.condition <= 1e10
    return {"visits": ~known & regular, "visits, W singular": ~known & ~regular, "synthetic": known & regular}


def drawn(mask: np.ndarray, count: int) -> np.ndarray:
    """At most `count` indices of a mask."""
    found = np.flatnonzero(mask)
    return np.random.default_rng(1).choice(found, count, replace=False) if len(found) > count else found


def contact(contacts: OneContacts, k: int) -> tuple[Contact, tuple]:
    """Contact k in velocity units and its start."""
    W, b = tuple(map(tuple, contacts.W[k].tolist())), tuple(contacts.b[k].tolist())
    c, sigma = scaled(W, b, float(contacts.mu[k]), 1.0, 0.0)
    return c, tuple((sigma * contacts.start[k]).tolist())


def full_steps(c: Contact, x: tuple, count: int) -> np.ndarray:
    """Iterates of Newton's method on the Alart–Curnier function, as far as they go."""
    iterates = []
    for _ in range(count):
        regular, d = solve3(*reversed(alart_curnier(c, x)))
        if not regular:
            break
        x = tuple(a - s for a, s in zip(x, d, strict=True))
        iterates.append(x)
    return np.array(iterates).reshape(-1, 3)


def cycle_length(iterates: np.ndarray) -> int:
    """Length of the cycle that the iterates end in, 0 for none of up to `CYCLES`."""
    size = np.abs(iterates[-CYCLES:]).max(initial=0.0)
    for length in range(2, CYCLES):
        gap = np.abs(iterates[-length:] - iterates[-2 * length : -length])
        if len(gap) == length and gap.max() <= 1e-6 * size:
            return length
    return 0


def pulls(contacts: OneContacts) -> np.ndarray:
    """Whether full steps from r = 0 go to a sticking impulse with `r_N < 0` and back."""
    W, b = contacts.W, contacts.b
    largest = np.linalg.eigvalsh(W[:, 1:, 1:])[:, 1]
    in_disc = np.linalg.norm(b[:, 1:], axis=1) / largest <= -contacts.mu * b[:, 0] / W[:, 0, 0]
    stick = -np.einsum("kij,kj->ki", np.linalg.pinv(W, hermitian=True), b)
    return (b[:, 0] < 0) & in_disc & (stick[:, 0] < 0)


def damped_end(function, c: Contact, x: tuple) -> tuple[tuple, np.ndarray]:
    """Last iterate of the damped Newton method, and the Jacobian there."""
    f, J = function(c, x)
    for _ in range(50):
        regular, d = solve3(J, f)
        size, t = np.linalg.norm(f), 1.0
        if not regular or size <= 1e-10 * np.linalg.norm(c.b):
            break
        while True:
            trial = tuple(a - t * s for a, s in zip(x, d, strict=True))
            f_trial, J_trial = function(c, trial)
            if np.linalg.norm(f_trial) <= (1 - ARMIJO * t) * size or t <= SHORTEST_STEP:
                break
            t *= 0.5
        if not np.linalg.norm(f_trial) < size:
            break
        x, f, J = trial, f_trial, J_trial
    return x, np.array(J)


def kink_distance(c: Contact, x: tuple) -> float:
    """`| |z_T| - mu z_N | / (|z_T| + mu z_N)` of the Alart–Curnier function."""
    u, (rho_N, rho_T) = np.array(c.W) @ x + c.b, steps(c.W, c.rho)
    size, radius = np.linalg.norm(np.array(x[1:]) - rho_T * u[1:]), c.mu * max(0.0, x[0] - rho_N * u[0])
    return abs(size - radius) / (size + radius)


def pac(contacts: OneContacts) -> dict[str, float]:
    lengths = np.array([cycle_length(full_steps(*contact(contacts, k), 400)) for k in range(contacts.m)])
    return {
        "cycles of two (%)": 100 * np.mean(lengths == 2),
        "longer cycles (%)": 100 * np.mean(lengths > 2),
        "take-off and pulling stick (%)": 100 * np.mean(pulls(contacts)),
    }


def dac(contacts: OneContacts) -> dict[str, float]:
    found = [contact(contacts, k) for k in range(contacts.m)]
    distances = np.array([kink_distance(c, damped_end(alart_curnier, c, x)[0]) for c, x in found])
    return {
        "at the kink of stick and slip (%)": 100 * np.mean(distances < CLOSE),
        "median distance from it": np.median(distances),
    }


def mfb(contacts: OneContacts) -> dict[str, float]:
    ends = [damped_end(modified_fischer_burmeister, *contact(contacts, k))[1] for k in range(contacts.m)]
    values = np.array([np.linalg.svd(J, compute_uv=False) for J in ends])
    coupling = contacts.mu * np.linalg.norm(contacts.W[:, 0, 1:], axis=1) / contacts.W[:, 0, 0]
    return {
        "Jacobian nearly singular (%)": 100 * np.mean(values[:, 2] < CLOSE * values[:, 0]),
        "median coupling": np.median(coupling),
    }


def quartic(contacts: OneContacts) -> dict[str, float]:
    errors = np.median([root_errors(contacts.select([k])) for k in range(contacts.m)], axis=0)
    return dict(
        zip(("median root / largest", "median error, closed", "median error, companion"), errors, strict=True)
    )


def root_errors(one: OneContacts) -> tuple[float, float, float]:
    """The root of the secular answer over the largest root of the quartic, and the errors of both ways to it."""
    W, b, mu = tuple(map(tuple, one.W[0].tolist())), tuple(one.b[0].tolist()), float(one.mu[0])
    r = replay(configure("secular", registered()), one).r[0]
    u, t = one.W[0] @ r + one.b[0], eliminate_normal(W, b)
    alpha = -(u[1:] @ r[1:]) / (r[1:] @ r[1:]) / alpha_unit(t)
    ways = (np.array(roots(slip_quartic(t, mu))[1]) for roots in (closed_roots, companion_roots))
    closed, companion = (np.abs(roots - alpha).min() for roots in ways)
    largest = np.abs(companion_roots(slip_quartic(t, mu))[1]).max()
    return abs(alpha) / largest, closed / largest, companion / largest


EXPLAIN = {"pac": pac, "dac": dac, "mfb": mfb, "enum-quartic": quartic, "enum-companion": quartic}


def evidence(contacts: OneContacts, sample: int) -> Iterator[tuple]:
    """Rows of the table: solver, kind, failures, how many were looked at, what, value."""
    for name, explain in EXPLAIN.items():
        local = configure(name, registered())
        found = replay(local, contacts)
        verdict = judge(contacts, found, local.facets)
        failed = ~verdict.solved & (found.status != Status.SINGULAR)
        for kind, mask in of_kind(contacts).items():
            count, which = int((failed & mask).sum()), drawn(failed & mask, sample)
            if count == 0:
                continue
            right = verdict.residual[which] <= tolerances(contacts, found.r)[which]
            what = {
                "operators": len(np.unique(contacts.W[failed & mask], axis=0)),
                "right (%)": 100 * np.mean(right),
            }
            what |= explain(contacts.select(which))
            if name == "mfb":
                pressed = drawn(verdict.solved & (contacts.b[:, 0] < 0) & mask, sample)
                control = explain(contacts.select(pressed))
                what |= {f"of successes: {words}": value for words, value in control.items()}
            yield from ((name, kind, count, len(which), words, value) for words, value in what.items())
        if name == "pac":
            must = pulls(contacts) & ~contacts.start.any(axis=1)
            share = 100 * np.mean(~verdict.solved[must]) if must.any() else np.nan
            yield name, "all", int(failed.sum()), int(must.sum()), "of those that must cycle, fail (%)", share


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--set", type=Path, default=Path("problems/one_contact.h5"))
    parser.add_argument("--sample", type=int, default=2000)
    parser.add_argument("--out", type=Path, default=Path("results/one_contact/evidence.csv"))
    given = parser.parse_args()
    with np.errstate(all="ignore"):  # iterates that diverge
        rows = evidence(read(given.set), given.sample)
        table = pd.DataFrame(rows, columns=["solver", "kind", "failures", "looked_at", "what", "value"])
    write_table(table, given.out)


if __name__ == "__main__":
    main()
