"""Slow, readable references for the tests: plain numpy, written from THEORY, sharing no code with the package."""

from dataclasses import replace

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq, nnls
from scipy.sparse import block_diag, csr_array

from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.step import StepProblem

TANGENT = np.diag([0.0, 1.0, 1.0])


def generators(mu, facets, toward):
    """Extreme rays of the pyramid (one a row); of the circular cone, those of its cut by the plane of `toward`."""
    if facets:
        angles = 2 * np.pi * np.arange(facets) / facets
    else:
        angle = np.arctan2(toward[2], toward[1])
        angles = np.array([angle, angle + np.pi])
    return np.column_stack([np.ones_like(angles), mu * np.cos(angles), mu * np.sin(angles)])


def project(x, mu, facets=0):
    """Projection on the cone as non-negative least squares over its generators."""
    x = np.asarray(x, dtype=float)
    size = np.abs(x).max()
    if size == 0:
        return np.zeros(3)
    G = generators(mu, facets, x)
    return size * G.T @ nnls(G.T, x / size)[0]


def support(direction, facets=0):
    """Support function of the unit disc, or of the regular polygon with a vertex on T1."""
    if not facets:
        return np.linalg.norm(direction)
    angles = 2 * np.pi * np.arange(facets) / facets
    return (np.cos(angles) * direction[0] + np.sin(angles) * direction[1]).max()


def natural_map(u, r, mu, sigma, facets=0):
    """`sigma r - P_K(sigma r - ũ)`."""
    u, r = np.asarray(u, dtype=float), np.asarray(r, dtype=float)
    changed = u + mu * support(-u[1:], facets) * np.array([1.0, 0.0, 0.0])
    return sigma * r - project(sigma * r - changed, mu, facets)


def local_residual(W, b, mu, r, facets=0):
    """Norm of the natural map of one contact, in the unit of b."""
    W, r = np.asarray(W), np.asarray(r)
    return np.linalg.norm(natural_map(W @ r + b, r, mu, np.trace(W) / 3, facets))


def arrow(x):
    """Matrix of the Jordan product with `x`."""
    A = x[0] * np.eye(len(x))
    A[0, 1:] = A[1:, 0] = x[1:]
    return A


def fischer_burmeister(x, y):
    """`x + y - (x∘x + y∘y)^(1/2)`, the square root from the eigenvalues of an arrow matrix."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    squares = arrow(x) @ x + arrow(y) @ y
    spectrum = np.sqrt(np.maximum(np.linalg.eigvalsh(arrow(squares))[[0, -1]], 0))
    tail = np.linalg.norm(squares[1:])
    direction = squares[1:] / tail if tail > 0 else np.zeros(2)
    root = 0.5 * np.concatenate([[spectrum.sum()], (spectrum[1] - spectrum[0]) * direction])
    return x + y - root


def residual(W, b, mu, r, facets=0, modified=False):
    """THEORY §2 on dense `W`: the natural-map residual, or (`modified`) the Fischer–Burmeister one."""
    n = len(mu)
    u, squares = (W @ r + b).reshape(n, 3), []
    for i in range(n):
        sigma, ri = np.trace(W[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]) / 3, r[3 * i : 3 * i + 3]
        if modified:
            x = np.array([mu[i], 1, 1]) * sigma * ri
            y = np.array([u[i, 0] + mu[i] * np.linalg.norm(u[i, 1:]), *(mu[i] * u[i, 1:])])
            squares.append(np.sum(fischer_burmeister(x, y) ** 2))
        else:
            squares.append(np.sum(natural_map(u[i], ri, mu[i], sigma, facets) ** 2))
    b_ref = np.sqrt(np.mean(np.sum(b.reshape(n, 3) ** 2, axis=1)))
    return np.sqrt(np.mean(squares)) / (b_ref if b_ref > 0 else 1.0)


def slip_impulse(W, b, alpha):
    """`r` with `u_N = 0` and `u_T = -alpha r_T`, for one alpha or an array of them."""
    A = W + np.multiply.outer(alpha, TANGENT)
    return -np.linalg.solve(A, np.broadcast_to(b, A.shape[:-1])[..., None])[..., 0]


def coulomb_solutions(W, b, mu):
    """Every solution of Coulomb's law at one contact with SPD `W`, by a dense scan over alpha."""
    W, b = np.asarray(W), np.asarray(b)
    found = [np.zeros(3)] if b[0] >= 0 else []
    stick = -np.linalg.solve(W, b)
    if np.linalg.norm(stick[1:]) <= mu * stick[0]:
        found.append(stick)
    if mu == 0:
        return found if found or b[0] >= 0 else [np.array([-b[0] / W[0, 0], 0.0, 0.0])]

    def phi(alpha):
        r = slip_impulse(W, b, alpha)
        return np.linalg.norm(r[..., 1:], axis=-1) - mu * r[..., 0]

    alphas = np.trace(W) * np.geomspace(1e-9, 1e9, 3601)
    signs = np.sign(phi(alphas))
    for k in np.flatnonzero(signs[1:] != signs[:-1]):
        r = slip_impulse(W, b, brentq(phi, alphas[k], alphas[k + 1], xtol=1e-300, rtol=1e-14))
        if r[0] > 0:
            found.append(r)
    return found


def gauss_seidel(W, b, mu, local, sweeps, proximal=0.0):
    """The iterates of block Gauss–Seidel on dense `W`, from zero; `local(W_ii, b_loc, mu_i, r_i)` is the solver."""
    r, iterates = np.zeros(len(b)), []
    for _ in range(sweeps):
        for i in range(len(mu)):
            at = slice(3 * i, 3 * i + 3)
            shift = proximal * np.trace(W[at, at]) / 3 * np.eye(3)
            others = b[at] + W[at] @ r - W[at, at] @ r[at]
            r[at] = local(W[at, at] + shift, others - shift @ r[at], mu[i], r[at])
        iterates.append(r.copy())
    return iterates


def finite_differences(function, x, step=1e-6):
    """Jacobian of a vector function by central differences, one column a variable."""
    columns = [(function(x + d) - function(x - d)) / (2 * step) for d in step * np.eye(len(x))]
    return np.column_stack(columns)


def rotation(rng, size=3):
    """A random orthogonal matrix."""
    Q, R = np.linalg.qr(rng.standard_normal((size, size)))
    return Q * np.sign(np.diag(R))


def turned(angle):
    """Rotation of the tangents `(T1, T2)` by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def definite(rng, condition, size=3):
    """A random SPD matrix of a given condition number: extreme eigenvalues fixed, the others between them."""
    exponents = np.concatenate([[0.0, -1.0], -rng.uniform(0, 1, size - 2)])
    Q = rotation(rng, size)
    W = Q * condition**exponents @ Q.T
    return 0.5 * (W + W.T)


def strands(seed, rods=4, dofs=18, contacts=8, mu=0.4, spread=1e2):
    """A step of rods with dense SPD blocks that touch in pairs; `b = H v_free`, so a solution exists."""
    rng = np.random.default_rng(seed)
    blocks = [definite(rng, spread, dofs) for _ in range(rods)]
    H = np.zeros((3 * contacts, rods * dofs))
    for i in range(contacts):
        for sign, rod in zip((1, -1), rng.choice(rods, 2, replace=False), strict=True):
            H[3 * i : 3 * i + 3, rod * dofs : (rod + 1) * dofs] = sign * rng.standard_normal((3, dofs))
    M = csr_array(block_diag(blocks, format="csr"))
    f = -M @ rng.standard_normal(rods * dofs)
    return StepProblem(M, f, csr_array(H), np.zeros(3 * contacts), np.full(contacts, float(mu)))


def elastica_tip(weight):
    """Tip of the heavy cantilever, unit length: `theta'' = −weight (1 − s) cos theta`, theta downwards."""
    s, guess = np.linspace(0, 1, 41), np.zeros((4, 41))
    for load in weight * np.array([0.01, 0.1, 0.3, 0.6, 1.0]):
        solution = solve_bvp(
            lambda s, y, load=load: np.array(
                [y[1], load * (s - 1) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]
            ),
            lambda root, free: np.array([root[0], free[1], root[2], root[3]]),
            s,
            guess,
            tol=1e-8,
            max_nodes=20000,
        )
        assert solution.success
        guess = solution.sol(s)
    return np.array([solution.y[2, -1], 0, -solution.y[3, -1]])


def walls(closing=1.0):
    """A mass between two walls that close in on it at this speed: no velocity satisfies both, unless it is <= 0."""
    W = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3))
    b = np.array([-closing, 0.0, 0.0, -closing, 0.0, 0.0])
    return IncrementalProblem.from_sparse(W, b, np.full(2, 0.3))


STEPS = {
    "stiff": strands(1, spread=1e4),
    "dense": strands(2, rods=3, contacts=12),
    "rank deficient": strands(3, rods=2, dofs=9, contacts=10, mu=0.7),
    "moving": replace(strands(4), w=0.2 * np.random.default_rng(4).random(24)),
    "mixed mu": replace(strands(5), mu=np.array([0.0, 0.0, 0.1, 0.3, 0.6, 1.0, 2.0, 5.0])),
}
