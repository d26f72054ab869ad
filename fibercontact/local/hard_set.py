"""Contacts that are hard, each family for a reason, with known answers: the synthetic part of the one-contact set.

Each answer is exact to rounding (`known_answer`). Where Coulomb's law has several at one contact (large mu, strong
coupling of normal and tangents) the known one is one of them. The starts are zero but in `bad start`.
"""

import random
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import count, product

import numpy as np
from numpy.typing import NDArray

from fibercontact.local.known_answer import (
    NOTHING,
    Exact,
    Known,
    Operator,
    between,
    coupled,
    decade,
    dot,
    gram,
    impulse,
    load,
    needed,
    pick,
    planar,
    ray,
    rounded,
    short,
    slip,
    solve2,
    stick,
    turned,
    unit,
    weak_along,
)
from fibercontact.local.one_contact import OneContacts

__all__ = ["FAMILIES", "hard_set"]

SEED = 2011
EACH = 12
"""Contacts of a kind at each rung of a ladder."""

Family = Callable[[random.Random], Iterator[Known]]

ONE, ZERO = Fraction(1), Fraction(0)


def hard_set() -> OneContacts:
    """All families one after the other, labelled `known: NAME`; the same bits at every call and on every machine."""
    known, labels = [], []
    for name, family in FAMILIES.items():
        drawn = list(family(random.Random(f"{SEED} {name}")))
        known += drawn
        labels += [f"known: {name}"] * len(drawn)
    return OneContacts(
        W=np.array([rounded(k.W) for k in known]),
        b=np.array([load(k) for k in known]),
        mu=np.array([float(k.mu) for k in known]),
        start=_doubles(k.start for k in known),
        family=np.array(labels),
        answer=_doubles(k.r for k in known),
    )


def _doubles(rows: Iterable[Exact]) -> NDArray[np.float64]:
    return np.array([[float(x) for x in row] for row in rows])


def kind(rng: random.Random) -> Operator:
    """An operator of condition number between 3 and 100: no difficulty by itself."""
    return turned(rng, decade(0.5 + 1.5 * rng.random()))


def moderate(rng: random.Random) -> Fraction:
    """A friction coefficient that is no difficulty by itself."""
    return short((0.1, 0.3, 0.6, 1.0)[pick(rng, 4)])


def any_friction(rng: random.Random) -> Fraction:
    """A friction coefficient from little to very much."""
    return short((0.1, 0.3, 1.0, 3.0, 10.0)[pick(rng, 5)])


def kind_slip(rng: random.Random) -> Known:
    """A slip that is hard in no way."""
    return slip(rng, kind(rng), moderate(rng), between(rng, 1e-1, 1e1))


def kind_stick(rng: random.Random) -> Known:
    """A stick that is hard in no way."""
    return stick(rng, kind(rng), moderate(rng))


def condition_slip(rng: random.Random) -> Iterator[Known]:
    """Slips, condition numbers 1 to 1e14."""
    for condition in map(decade, range(15)):
        yield from needed(
            4 * EACH,
            (slip(rng, turned(rng, condition), any_friction(rng), between(rng, 1e-2, 1e2)) for _ in count()),
        )


def condition_stick(rng: random.Random) -> Iterator[Known]:
    """Sticks, condition numbers 1 to 1e14."""
    for condition in map(decade, range(15)):
        yield from needed(2 * EACH, (stick(rng, turned(rng, condition), any_friction(rng)) for _ in count()))


def weak_axis(rng: random.Random) -> Iterator[Known]:
    """Impulses along the weakest axis of `W`: `sigma r` is larger than b by the condition number, up to 1e14."""

    def along(known: Known, condition: Fraction) -> Known:
        return known._replace(W=weak_along(known.r, condition), u=_times(1 / condition, known.u))

    for condition in map(decade, range(1, 15)):
        yield from needed(EACH, (along(kind_slip(rng), condition) for _ in count()))
        yield from needed(EACH, (along(kind_stick(rng), condition) for _ in count()))


def friction(rng: random.Random) -> Iterator[Known]:
    """Friction coefficients 0 to 100, slips and sticks."""
    for mu in map(short, (0.0, 1e-4, 1e-3, 1e-2, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)):
        yield from needed(2 * EACH, (slip(rng, kind(rng), mu, between(rng, 1e-1, 1e2)) for _ in count()))
        yield from needed(2 * EACH, (stick(rng, kind(rng), mu) for _ in count()))


def lifted(rng: random.Random, delta: Fraction, speed: Fraction) -> Known:
    """A slip whose friction `mu e` lifts the contact by all but `delta` of what `W_NN r_N` presses it."""
    mu, (r_N, e) = moderate(rng), ray(rng)
    W_NN = between(rng, 0.1, 10.0)
    factor = (delta - 1) * W_NN / (mu * r_N)
    reduced = planar(unit(rng), between(rng, 0.1, 10.0), between(rng, 0.1, 10.0))
    W = coupled(W_NN, (factor * e[0], factor * e[1]), reduced)
    return Known(W, mu, impulse(r_N, e, mu), (ZERO, -speed * e[0], -speed * e[1]))


def normal_load_below(rng: random.Random) -> Iterator[Known]:
    """`b_N` just below 0 with an impulse that is not small: friction lifts nearly as much as the load presses."""
    for delta in map(decade, range(-1, -14, -1)):
        yield from needed(EACH, (lifted(rng, delta, between(rng, 1e-2, 1e2)) for _ in count()))
        yield from needed(EACH, (lifted(rng, delta, ZERO) for _ in count()))


def normal_load_above(rng: random.Random) -> Iterator[Known]:
    """`b_N` at 0 and just above, coupled in the same way: take-off is an answer, slips may be."""
    for delta in (ZERO, *map(decade, range(-1, -17, -1))):
        for _ in range(EACH):
            known = lifted(rng, ZERO, between(rng, 1e-2, 1e2))
            yield known._replace(r=NOTHING, u=(delta, *known.u[1:]))


def stick_slip_edge(rng: random.Random) -> Iterator[Known]:
    """Impulses on the boundary of the cone at rest, just inside, or hardly sliding."""

    def inside(delta: Fraction) -> Known:
        mu, (r_N, e) = moderate(rng), ray(rng)
        tangential = (Fraction(float((1 - delta) * mu * x)) for x in e)
        return Known(kind(rng), mu, (r_N, *tangential), NOTHING)

    def sliding(speed: Fraction) -> Known:
        return slip(rng, kind(rng), moderate(rng), speed)

    yield from needed(4 * EACH, (sliding(ZERO) for _ in count()))
    for delta in map(decade, range(-2, -16, -1)):
        yield from needed(EACH, (inside(delta) for _ in count()))
        yield from needed(EACH, (sliding(delta) for _ in count()))


def slip_take_off_edge(rng: random.Random) -> Iterator[Known]:
    """Impulses that vanish while the contact slides, and contacts that graze or hardly leave."""

    def small(known: Known, factor: Fraction) -> Known:
        return known._replace(r=_times(factor, known.r))

    for delta in map(decade, range(-1, -17, -1)):
        yield from needed(EACH, (small(kind_slip(rng), delta) for _ in count()))
    for delta in (ZERO, *map(decade, range(-1, -17, -1))):
        for _ in range(EACH):
            known = kind_slip(rng)
            yield known._replace(r=NOTHING, u=(delta, *known.u[1:]))


def merged(rng: random.Random, roots: int, gap: Fraction) -> Known:
    """A slip at which `roots` (2 or 3) solutions of the secular equation `phi(alpha) = 0` merge, up to `gap`.

    With `A = W̄ + alpha I`, `r̂ = r_T/|r_T|`, `y = A⁻¹ r̂` and `omega = mu w / W_NN` (THEORY §3), `r_T' = -A⁻¹ r_T`
    along the slips. `phi' = 0` is `(omega + r̂)·y = 0`: `omega = k y⊥ - r̂` for any k. `phi'' = 0` besides is
    `2 k y⊥·A⁻¹y = (r̂·y)² - |y|²`. With `y⊥·r̂ > 0`, k is positive and `b_N = -W_NN r_N (1 + omega·r̂)` negative.
    """
    mu, (r_N, e) = any_friction(rng), ray(rng)
    along = (e[0] / r_N, e[1] / r_N)
    alpha = between(rng, 0.1, 10.0)
    least = alpha + between(rng, 0.1, 10.0)
    A = planar(unit(rng), least, least * between(rng, 1.5, 20.0))
    y = solve2(A, along)
    across = (-y[1], y[0]) if y[0] * along[1] > y[1] * along[0] else (y[1], -y[0])
    bend = 2 * dot(across, solve2(A, y))
    if bend == 0:
        return merged(rng, roots, gap)  # r_T along an axis of A: no coupling merges anything
    k = (dot(along, y) ** 2 - dot(y, y)) / bend
    k *= 1 if roots == 3 else between(rng, 0.2, 5.0)
    W_NN = between(rng, 0.1, 10.0)
    w = tuple(W_NN / mu * (k * a - (1 + gap) * c) for a, c in zip(across, along, strict=True))
    W = coupled(W_NN, (w[0], w[1]), (A[0] - alpha, A[1], A[2] - alpha))
    r = impulse(r_N, e, mu)
    return Known(W, mu, r, (ZERO, -alpha * r[1], -alpha * r[2]))


def merging(roots: int) -> Family:
    """Family of slips where so many solutions merge."""

    def family(rng: random.Random) -> Iterator[Known]:
        gaps = (ZERO, *(sign * decade(-k) for k in range(2, 15) for sign in (1, -1)))
        for gap in gaps:
            number = EACH if gap else 8 * EACH
            yield from needed(number, (merged(rng, roots, gap) for _ in count()))

    family.__doc__ = (
        f"{roots} slips merge, or are apart by 1e-14 to 1e-2: a root of multiplicity {roots} of the quartic."
    )
    return family


def uncoupled(rng: random.Random) -> Iterator[Known]:
    """`W_NT = 0`: the quartic is degenerate; isotropic tangents, and loads along an axis of `W_TT`, among them."""

    def sliding(shape: str) -> Known:
        mu, (r_N, e) = moderate(rng), ray(rng)
        axis = (e[0] / r_N, e[1] / r_N) if shape == "aligned" else unit(rng)
        first = between(rng, 1e-2, 1e2)
        second = first if shape == "isotropic" else first * decade(-6 * rng.random())
        W = coupled(between(rng, 1e-2, 1e2), (ZERO, ZERO), planar(axis, first, second))
        speed = between(rng, 1e-2, 1e2)
        return Known(W, mu, impulse(r_N, e, mu), (ZERO, -speed * e[0], -speed * e[1]))

    def resting() -> Known:
        reduced = planar(unit(rng), ONE, decade(-3 * rng.random()))
        return stick(rng, coupled(between(rng, 0.1, 10.0), (ZERO, ZERO), reduced), moderate(rng))

    for shape in ("isotropic", "aligned", "general"):
        yield from needed(6 * EACH, (sliding(shape) for _ in count()))
    yield from needed(6 * EACH, (resting() for _ in count()))


def singular(rank: int) -> Family:
    """Family of contacts with a `W` of that rank, exactly: `Σ a aᵀ` over small integer vectors."""

    def operator(rng: random.Random) -> Operator:
        columns = tuple(tuple(Fraction(pick(rng, 15) - 7) for _ in range(3)) for _ in range(rank))
        return gram(columns, (Fraction(1, 16),) * rank)

    def family(rng: random.Random) -> Iterator[Known]:
        sliding = (slip(rng, operator(rng), moderate(rng), between(rng, 1e-2, 1e2)) for _ in count())
        yield from needed(10 * EACH, sliding)
        yield from needed(10 * EACH, (stick(rng, operator(rng), moderate(rng)) for _ in count()))

    family.__doc__ = f"`W` of rank {rank}: sticks, for which b is in its range, and slips."
    return family


def normal_only(rng: random.Random) -> Iterator[Known]:
    """Only `W_NN`: no impulse changes the sliding velocity."""
    for _ in range(4 * EACH):
        W = coupled(between(rng, 1e-2, 1e2), (ZERO, ZERO), (ZERO, ZERO, ZERO))
        yield slip(rng, W, moderate(rng), between(rng, 1e-2, 1e2))
        yield Known(W, moderate(rng), (ONE, ZERO, ZERO), NOTHING)


def scales(rng: random.Random) -> Iterator[Known]:
    """`W` and b scaled by 1e-12 to 1e12, each by itself."""
    exponents = range(-12, 13, 4)
    for s, t in product(map(decade, exponents), map(decade, exponents)):
        for draw in (kind_slip, kind_stick):
            for known in needed(EACH // 3, (draw(rng) for _ in count())):
                yield scaled(known, s, t)


def scaled(known: Known, s: Fraction, t: Fraction) -> Known:
    """The contact of `sW` and `tb`; s and t are powers of two, so nothing is rounded anew."""
    rows = [tuple(s * Fraction(x) for x in row) for row in rounded(known.W)]
    return Known((rows[0], rows[1], rows[2]), known.mu, _times(t / s, known.r), _times(t, known.u))


def _times(factor: Fraction, x: Exact) -> Exact:
    return tuple(factor * c for c in x)


BAD_STARTS: Sequence[Callable[[Exact], Exact]] = (
    lambda r: _times(decade(6), r),
    lambda r: _times(decade(12), r),
    lambda r: _times(decade(-12), r),
    lambda r: _times(-ONE, r),
    lambda r: (r[0], -r[1], -r[2]),
    lambda r: (-r[0], r[1], r[2]),
    lambda r: (ZERO, ONE, ONE),
    lambda r: (ONE, ZERO, ZERO),
    lambda r: _times(decade(3), (r[2], r[0], r[1])),
)
"""Wrong starts, from the answer."""


def bad_start(rng: random.Random) -> Iterator[Known]:
    """Starts from far off, from outside of the cone, from the wrong side and from a wrong regime."""

    def leaving() -> Known:
        known = kind_slip(rng)
        return known._replace(u=(between(rng, 1e-2, 1.0), *known.u[1:]))

    for start in BAD_STARTS:
        for draw in (kind_slip, kind_stick):
            for known in needed(EACH, (draw(rng) for _ in count())):
                yield known._replace(start=start(known.r))
        for known in (leaving() for _ in range(EACH)):
            yield known._replace(r=NOTHING, start=start(known.r))


FAMILIES: dict[str, Family] = {
    "condition, slip": condition_slip,
    "condition, stick": condition_stick,
    "impulse along the weak axis": weak_axis,
    "friction": friction,
    "b_N just below 0": normal_load_below,
    "b_N at 0 and above": normal_load_above,
    "stick/slip edge": stick_slip_edge,
    "slip/take-off edge": slip_take_off_edge,
    "double root": merging(2),
    "triple root": merging(3),
    "W_NT = 0": uncoupled,
    "singular, rank 2": singular(2),
    "singular, rank 1": singular(1),
    "singular, W_NN only": normal_only,
    "scales": scales,
    "bad start": bad_start,
}
"""The families by name."""
