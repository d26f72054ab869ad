"""Broad phase: pairs of segments of different fibres that may be near, by a uniform spatial hash."""

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_lean
from fibercontact.threads import over_ranges

__all__ = ["near_segments"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_CELL = 16.0  # radii; smaller cells cost more entries, larger ones more pairs in tight bundles
_PIECES = 16  # of a segment of mean length, at most
_SEGMENTS = 4096  # of a range, for a thread


def near_segments(start: Floats, end: Floats, reach: Floats, fibre: Ints) -> Ints:
    """Pairs (k, 2) of segments i < j of different `fibre`, among them all that are within reach_i + reach_j.

    Segments go from `start` (n, 3) to `end` (n, 3); `fibre` (n,) is increasing. A pair comes out once. The
    hash holds the cells that short pieces of each segment cover, so that long thin segments in a tight bundle
    meet only their neighbours. The cell size is a cubic mean over the segments: memory is linear in n however
    unequal they are.
    """
    length = np.linalg.norm(end - start, axis=1)
    cell = max(_CELL * _cubic_mean(reach), _cubic_mean(length) / _PIECES)
    pieces = np.maximum(np.ceil(2.0 * length / cell), 1.0).astype(np.int64)
    origin = np.minimum(start, end).min(axis=0) - reach.max()
    boxes = _piece_boxes((start - origin) / cell, (end - origin) / cell, reach / cell, pieces)
    covered = int(np.prod(boxes[:, 1] - boxes[:, 0] + 1, axis=1).sum())
    first = np.concatenate(([0], np.cumsum(pieces)))
    buckets = 1 << covered.bit_length()
    offset, entry = _entries(boxes, first, covered, buckets)
    bucket_offset, segment = _transposed(offset, entry, buckets)

    def pairs_of(begin: int, stop: int) -> Ints:
        return _pairs(start, end, reach, fibre, offset, entry, bucket_offset, segment, begin, stop)

    return np.concatenate(over_ranges(pairs_of, len(start), _SEGMENTS))


def _cubic_mean(x: Floats) -> float:
    return float(x.max() * np.cbrt(np.mean((x / x.max()) ** 3))) if x.max() > 0.0 else 0.0


@jit
def _piece_boxes(start: Floats, end: Floats, reach: Floats, pieces: Ints) -> Ints:
    """First and last cell (p, 2, 3) that each piece of each segment covers; lengths in cells."""
    boxes = np.empty((pieces.sum(), 2, 3), np.int64)
    row = 0
    for i in range(len(start)):
        for piece in range(pieces[i]):
            for axis in range(3):
                step = (end[i, axis] - start[i, axis]) / pieces[i]
                x = start[i, axis] + piece * step
                boxes[row, 0, axis] = np.int64(np.floor(min(x, x + step) - reach[i]))
                boxes[row, 1, axis] = np.int64(np.floor(max(x, x + step) + reach[i]))
            row += 1
    return boxes


@jit
def _bucket(i: int, j: int, k: int, buckets: int) -> int:
    """Hash of a cell [Teschner et al. 2003, Optimized spatial hashing, VMV]; `buckets` is a power of two."""
    return ((i * 73856093) ^ (j * 19349663) ^ (k * 83492791)) & (buckets - 1)


@jit
def _entries(boxes: Ints, first: Ints, covered: int, buckets: int) -> tuple[Ints, Ints]:
    """Buckets of segment i, each once: `entry[offset[i]:offset[i + 1]]`."""
    offset = np.zeros(len(first), np.int64)
    entry = np.empty(covered, np.int64)
    latest = np.full(buckets, -1)
    count = 0
    for i in range(len(first) - 1):
        for p in range(first[i], first[i + 1]):
            for x in range(boxes[p, 0, 0], boxes[p, 1, 0] + 1):
                for y in range(boxes[p, 0, 1], boxes[p, 1, 1] + 1):
                    for z in range(boxes[p, 0, 2], boxes[p, 1, 2] + 1):
                        bucket = _bucket(x, y, z, buckets)
                        if latest[bucket] != i:
                            latest[bucket] = i
                            entry[count] = bucket
                            count += 1
        offset[i + 1] = count
    return offset, entry[:count]


@jit
def _transposed(offset: Ints, entry: Ints, buckets: int) -> tuple[Ints, Ints]:
    """Segments of bucket b in increasing order: `segment[bucket_offset[b]:bucket_offset[b + 1]]`."""
    bucket_offset = np.zeros(buckets + 1, np.int64)
    for bucket in entry:
        bucket_offset[bucket] += 1
    bucket_offset = np.cumsum(bucket_offset)
    segment = np.empty(len(entry), np.int64)
    for i in range(len(offset) - 2, -1, -1):
        for at in range(offset[i], offset[i + 1]):
            bucket = entry[at]
            bucket_offset[bucket] -= 1
            segment[bucket_offset[bucket]] = i
    return bucket_offset, segment


@jit_lean
def _apart(start: Floats, end: Floats, i: int, j: int, distance: float) -> bool:
    """Whether a cylinder round the line of segment i that bounds segment j proves them farther apart."""
    ux, uy, uz = end[i, 0] - start[i, 0], end[i, 1] - start[i, 1], end[i, 2] - start[i, 2]
    hx, hy, hz = end[j, 0] - start[j, 0], end[j, 1] - start[j, 1], end[j, 2] - start[j, 2]
    hx, hy, hz = 0.5 * hx, 0.5 * hy, 0.5 * hz
    mx, my, mz = (
        start[j, 0] + hx - start[i, 0],
        start[j, 1] + hy - start[i, 1],
        start[j, 2] + hz - start[i, 2],
    )
    uu = ux * ux + uy * uy + uz * uz
    hu = ux * hx + uy * hy + uz * hz
    mu = ux * mx + uy * my + uz * mz
    across = (hx * hx + hy * hy + hz * hz) * uu - hu * hu
    away = (mx * mx + my * my + mz * mz) * uu - mu * mu
    reach = np.sqrt(max(across, 0.0)) + distance * np.sqrt(uu)
    return away > reach * reach or abs(mu - 0.5 * uu) > 0.5 * uu + abs(hu) + distance * np.sqrt(uu)


@jit
def _pairs(
    start: Floats,
    end: Floats,
    reach: Floats,
    fibre: Ints,
    offset: Ints,
    entry: Ints,
    bucket_offset: Ints,
    segment: Ints,
    begin: int,
    stop: int,
) -> Ints:
    """Pairs (k, 2) of segments i in begin..stop and j > i that share a bucket and are not proved apart."""
    found = np.empty((max(stop - begin, 1), 2), np.int64)
    count = 0
    seen = np.full(len(start), -1)
    for i in range(begin, stop):
        for at in range(offset[i], offset[i + 1]):
            bucket = entry[at]
            # In a bucket segments increase: from the back come the later fibres, and the rest is not needed.
            for place in range(bucket_offset[bucket + 1] - 1, bucket_offset[bucket] - 1, -1):
                j = segment[place]
                if fibre[j] <= fibre[i]:
                    break
                if seen[j] == i:
                    continue
                seen[j] = i
                if _apart(start, end, i, j, reach[i] + reach[j]):
                    continue
                if count == len(found):
                    found = np.concatenate((found, np.empty_like(found)))
                found[count, 0], found[count, 1] = i, j
                count += 1
    return found[:count]
