"""Minimum cut of a grid graph, in integers.

The algorithm is that of Boykov and Kolmogorov 2004, "An experimental comparison of min-cut/max-flow algorithms for
energy minimization in vision": two trees grow from source and sink until they touch, the path is saturated, and what
that tears off is adopted again where possible. The minimum cut nearest the source is unique, so the result doesn't
depend on the order in which the trees grow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from tilefab.jit import kernel

_FREE, _NEW, _OLD = 0, 1, 2
_NO_PARENT, _TERMINAL, _ORPHAN = -2, -1, -3
_FAR = 1 << 30


@kernel
def grid_cut(capacities: NDArray[np.int64], terminals: NDArray[np.int64], width: int) -> NDArray[np.bool_]:
    """Side of the minimum cut on which each node of a grid lies.

    Parameters
    ----------
    capacities
        (4, nodes) int64 >= 0: of the arcs to the node at +1, -1, +width and -width. Those to and from the grid's
        border, one node wide, are 0. Overwritten.
    terminals
        (nodes,) int64: capacity from the source if > 0, to the sink if < 0; 0 on the border. Overwritten.
    width
        Nodes in a row, those of the border included: no arc may lead to or from them.

    Returns
    -------
    ndarray of bool
        (nodes,), True where a node can still be reached from the source: of all minimum cuts, the one with the
        fewest nodes on the source's side.

    Notes
    -----
    Twin: `grid_cut_plain`.
    """
    nodes = terminals.size
    offsets = np.array([1, -1, width, -width])
    tree = np.zeros(nodes, np.uint8)
    parent = np.full(nodes, _NO_PARENT, np.int8)
    stamp = np.zeros(nodes, np.int32)
    depth = np.zeros(nodes, np.int32)
    # Rings that hold each node at most once.
    active = np.zeros(nodes, np.int64)
    is_active = np.zeros(nodes, np.bool_)
    active_head = active_count = 0
    orphans = np.zeros(nodes, np.int64)
    orphan_head = orphan_count = 0
    for node in range(nodes):
        if terminals[node] != 0:
            tree[node] = _NEW if terminals[node] > 0 else _OLD
            parent[node] = _TERMINAL
            depth[node] = 1
            active[active_count] = node
            is_active[node] = True
            active_count += 1
    time = np.int32(0)
    while active_count > 0:
        node = active[active_head]
        # Grow from the node until the trees touch.
        start = end = -1
        if tree[node] != _FREE:
            for d in range(4):
                other = node + offsets[d]
                residual = capacities[d, node] if tree[node] == _NEW else capacities[d ^ 1, other]
                if residual == 0:
                    continue
                if tree[other] == _FREE:
                    tree[other] = tree[node]
                    parent[other] = d ^ 1
                    stamp[other] = stamp[node]
                    depth[other] = depth[node] + 1
                    if not is_active[other]:
                        active[(active_head + active_count) % nodes] = other
                        is_active[other] = True
                        active_count += 1
                elif tree[other] != tree[node]:
                    if tree[node] == _NEW:
                        start, end, across = node, other, d
                    else:
                        start, end, across = other, node, d ^ 1
                    break
                elif stamp[other] <= stamp[node] and depth[other] > depth[node]:
                    parent[other] = d ^ 1
                    stamp[other] = stamp[node]
                    depth[other] = depth[node] + 1
        if start < 0:
            is_active[node] = False
            active_head = (active_head + 1) % nodes
            active_count -= 1
            continue
        # Saturate the path.
        time += np.int32(1)
        flow = capacities[across, start]
        k = start
        while parent[k] != _TERMINAL:
            up = parent[k]
            k += offsets[up]
            flow = min(flow, capacities[up ^ 1, k])
        flow = min(flow, terminals[k])
        k = end
        while parent[k] != _TERMINAL:
            flow = min(flow, capacities[parent[k], k])
            k += offsets[parent[k]]
        flow = min(flow, -terminals[k])
        capacities[across, start] -= flow
        capacities[across ^ 1, end] += flow
        k = start
        while parent[k] != _TERMINAL:
            up = parent[k]
            above = k + offsets[up]
            capacities[up ^ 1, above] -= flow
            capacities[up, k] += flow
            if capacities[up ^ 1, above] == 0:
                parent[k] = _ORPHAN
                orphans[(orphan_head + orphan_count) % nodes] = k
                orphan_count += 1
            k = above
        terminals[k] -= flow
        if terminals[k] == 0:
            parent[k] = _ORPHAN
            orphans[(orphan_head + orphan_count) % nodes] = k
            orphan_count += 1
        k = end
        while parent[k] != _TERMINAL:
            up = parent[k]
            above = k + offsets[up]
            capacities[up, k] -= flow
            capacities[up ^ 1, above] += flow
            if capacities[up, k] == 0:
                parent[k] = _ORPHAN
                orphans[(orphan_head + orphan_count) % nodes] = k
                orphan_count += 1
            k = above
        terminals[k] += flow
        if terminals[k] == 0:
            parent[k] = _ORPHAN
            orphans[(orphan_head + orphan_count) % nodes] = k
            orphan_count += 1
        # Adopt what was torn off.
        while orphan_count > 0:
            orphan = orphans[orphan_head]
            orphan_head = (orphan_head + 1) % nodes
            orphan_count -= 1
            side = tree[orphan]
            best, nearest = -1, np.int64(_FAR)
            for d in range(4):
                other = orphan + offsets[d]
                if tree[other] != side:
                    continue
                residual = capacities[d ^ 1, other] if side == _NEW else capacities[d, orphan]
                if residual == 0:
                    continue
                steps, k = np.int64(0), other
                while True:
                    if stamp[k] == time:
                        steps += depth[k]
                        break
                    up = parent[k]
                    steps += 1
                    if up == _TERMINAL:
                        stamp[k] = time
                        depth[k] = 1
                        break
                    if up < 0:
                        steps = np.int64(_FAR)
                        break
                    k += offsets[up]
                if steps >= _FAR:
                    continue
                if steps < nearest:
                    best, nearest = d, steps
                k = other
                while stamp[k] != time:
                    stamp[k] = time
                    depth[k] = steps
                    steps -= 1
                    k += offsets[parent[k]]
            if best >= 0:
                parent[orphan] = best
                stamp[orphan] = time
                depth[orphan] = nearest + 1
                continue
            for d in range(4):
                other = orphan + offsets[d]
                if tree[other] != side:
                    continue
                residual = capacities[d ^ 1, other] if side == _NEW else capacities[d, orphan]
                if residual > 0 and not is_active[other]:
                    active[(active_head + active_count) % nodes] = other
                    is_active[other] = True
                    active_count += 1
                if parent[other] == d ^ 1:
                    parent[other] = _ORPHAN
                    orphans[(orphan_head + orphan_count) % nodes] = other
                    orphan_count += 1
            parent[orphan] = _NO_PARENT
            tree[orphan] = _FREE
    result: NDArray[np.bool_] = tree == _NEW
    return result


def grid_cut_plain(capacities: NDArray[np.int64], terminals: NDArray[np.int64], width: int) -> NDArray[np.bool_]:
    """Plain twin of `grid_cut`, by SciPy's maximum flow; capacities below 2**31 only."""
    nodes = terminals.size
    source, sink = nodes, nodes + 1
    heads, tails, limits = [], [], []
    for d, offset in enumerate((1, -1, width, -width)):
        there = np.flatnonzero(capacities[d])
        heads.append(there)
        tails.append(there + offset)
        limits.append(capacities[d, there])
    for sign, terminal in ((1, source), (-1, sink)):
        there = np.flatnonzero(sign * terminals > 0)
        ends = np.full(there.size, terminal)
        heads.append(ends if sign > 0 else there)
        tails.append(there if sign > 0 else ends)
        limits.append(np.abs(terminals[there]))
    arcs = np.concatenate(heads), np.concatenate(tails)
    graph = sparse.coo_matrix((np.concatenate(limits).astype(np.int32), arcs), shape=(nodes + 2, nodes + 2)).tocsr()
    residual = graph - maximum_flow(graph, source, sink).flow
    residual.data[residual.data < 0] = 0
    residual.eliminate_zeros()
    reached = np.zeros(nodes + 2, dtype=bool)
    reached[breadth_first_order(residual, source, return_predecessors=False)] = True
    result: NDArray[np.bool_] = reached[:nodes]
    return result
