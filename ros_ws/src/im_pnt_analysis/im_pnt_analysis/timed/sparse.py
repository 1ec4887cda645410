"""Steady state of large Markov chains by sparse linear algebra, with a checked residual."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph, linalg

from im_pnt.errors import NetError
from im_pnt_analysis.timed.elimination import Rows

RESIDUAL = 1e-11
"""Largest imbalance of a state that is accepted, relative to the largest flow through any state."""

_ERROR = 1e-12
"""Error at which sweeps may stop, relative to the largest flow."""

_SLOW = 0.999
"""Factor by which a sweep must reduce the changes; where it does not, factorisation is faster."""

_SWEEPS = 20_000
_BETWEEN_CHECKS = 20

Vector = NDArray[np.float64]


def stationary_sparse(rows: Rows, states: Sequence[int]) -> tuple[dict[int, float], str]:
    """Compute the stationary measure of a large irreducible chain.

    Gauss-Seidel sweeps while they converge well, a sparse LU factorisation where they do not (Stewart, Introduction to
    the Numerical Solution of Markov Chains, 1994, chapters 2 and 3).

    Args:
        rows: Rates; what leads out of ``states`` is not there.
        states: The states of the chain.

    Returns:
        The measure, its sum 1, and how it was obtained.

    Raises:
        NetError: The equations could not be solved well enough.
    """
    n = len(states)
    inflow = _matrix(rows, states).T.tocsc()
    out = np.asarray(inflow.sum(axis=0)).ravel()
    # In terms of flows (rate times probability) the matrix is I - P', whose entries do not depend on the time scale.
    step = (inflow @ sparse.diags_array(1.0 / out)).tocsr()
    balance = (sparse.identity(n, format="csr") - step).tocsc()
    flow, converged = _sweep(balance)
    method = "Gauss-Seidel"
    if not converged:
        flow, method = _factorise(balance, int(flow.argmax())), "sparse LU"
    residual = float(np.abs(balance @ flow).max() / np.abs(flow).max())
    if not residual <= RESIDUAL or flow.min() < -RESIDUAL * flow.max():
        raise NetError(
            f"the balance equations of {n} markings could not be solved: residual {residual:.1e}, {RESIDUAL:g} is "
            "allowed. 'scripts/im pnt simulate --summary' estimates by simulation what cannot be computed"
        )
    time = np.maximum(flow, 0.0) / out
    time /= time.sum()
    return dict(zip(states, time.tolist(), strict=True)), f"{method}, residual {residual:.1e}"


def _sweep(balance: Any) -> tuple[Vector, bool]:
    """Sweep over the states until balance; return whether balance was reached.

    The error that is left is judged by the rate at which the changes shrink, not by their size alone.
    """
    n = balance.shape[0]
    lower = sparse.tril(balance).tocsc()
    upper = (lower - balance).tocsr()
    natural = {"permc_spec": "NATURAL", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    solve = linalg.splu(lower, **natural).solve
    flow: Vector = np.full(n, 1.0 / n)
    before = np.inf
    for _ in range(_SWEEPS // _BETWEEN_CHECKS):
        for _ in range(_BETWEEN_CHECKS):
            last, flow = flow, solve(upper @ flow)
        change = float(np.abs(flow - last).max() / flow.max())
        flow /= flow.sum()
        if change < 1e-15:
            return flow, True
        if before < np.inf:
            shrinking = (change / before) ** (1.0 / _BETWEEN_CHECKS)
            if shrinking >= _SLOW:
                return flow, False
            if change / (1.0 - shrinking) < _ERROR:
                return flow, True
        before = change
    return flow, False


def _factorise(balance: Any, reference: int) -> Vector:
    """Solve for the flows relative to the flow of one state."""
    others = np.delete(np.arange(balance.shape[0]), reference)
    right = -balance[others][:, [reference]].toarray().ravel()
    try:
        flow: Vector = linalg.splu(balance[others][:, others].tocsc(), permc_spec="MMD_AT_PLUS_A").solve(right)
    except (RuntimeError, MemoryError):
        return np.full(balance.shape[0], np.nan)
    return np.insert(flow, reference, 1.0)


def _matrix(rows: Rows, states: Sequence[int]) -> Any:
    number = {state: i for i, state in enumerate(states)}
    entries = [(i, number[j], float(rate)) for i, state in enumerate(states) for j, rate in rows[state].items()]
    source, target, rate = (np.array(column) for column in zip(*entries, strict=True))
    return sparse.csr_matrix((rate, (source, target)), shape=(len(states), len(states)))


def remaining_time(rows: Rows, tangible: Sequence[bool], ends: Sequence[int]) -> list[float]:
    """Compute the expected time until one of the ends, from each state.

    Args:
        rows: Rates of tangible states, weights of vanishing ones.
        tangible: For each state whether time passes in it.
        ends: States where the count stops; one of them is reached from every state.
    """
    n = len(rows)
    step = sparse.diags_array(np.isin(np.arange(n), ends, invert=True).astype(float)) @ _matrix(rows, range(n))
    out = np.asarray(step.sum(axis=1)).ravel()
    scale = np.where(out > 0.0, out, 1.0)
    left = sparse.identity(n, format="csc") - sparse.diags_array(1.0 / scale) @ step
    right = np.where(np.asarray(tangible) & (out > 0.0), 1.0 / scale, 0.0)
    time: list[float] = np.atleast_1d(linalg.spsolve(left.tocsc(), right)).tolist()
    return time


def bottom_classes(arcs: Sequence[Sequence[tuple[int, int, int]]]) -> list[list[int]]:
    """Find the recurrent classes of a graph: strongly connected sets of states without a way out."""
    source = np.repeat(np.arange(len(arcs)), [len(row) for row in arcs])
    target = np.fromiter((arc[1] for row in arcs for arc in row), dtype=np.int64, count=len(source))
    graph = sparse.csr_matrix((np.ones(len(source), dtype=np.int8), (source, target)), shape=(len(arcs), len(arcs)))
    count, label = csgraph.connected_components(graph, directed=True, connection="strong")
    leaves = np.zeros(count, dtype=bool)
    leaves[label[source[label[source] != label[target]]]] = True
    members: dict[int, list[int]] = {}
    for state in np.flatnonzero(~leaves[label]).tolist():
        members.setdefault(int(label[state]), []).append(state)
    return list(members.values())
