"""Open surfaces whose border is known: a closed mesh without what lies beyond a plane; and how near two borders are.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import collections
import math

import models


def points_of(path):
    """(points, flat corners) of a mesh."""
    columns, corners = models.read_ply(path)
    return list(zip(columns["x"], columns["y"], columns["z"])), corners


def triangles_of(corners):
    return (corners[i:i + 3] for i in range(0, len(corners), 3))


def cut(points, corners, is_kept):
    """The part of the mesh whose points are kept; (points, flat corners)."""
    of_triangles = [triangle for triangle in triangles_of(corners) if all(is_kept(points[v]) for v in triangle)]
    number = {old: new for new, old in enumerate(sorted({v for triangle in of_triangles for v in triangle}))}
    return [points[old] for old in number], [number[v] for triangle in of_triangles for v in triangle]


def write(path, points, corners):
    models.write_ply(path, [c for point in points for c in point], corners)


def loops_of(corners):
    """The vertices of each border, all the way around, the shortest first."""
    edges = {edge for a, b, c in triangles_of(corners) for edge in ((a, b), (b, c), (c, a))}
    after = collections.defaultdict(list)
    for a, b in edges:
        if (b, a) not in edges:
            after[b].append(a)
    loops = []
    for start, ends in after.items():
        while ends:
            loop, vertex = [], start
            while after[vertex]:
                loop.append(vertex)
                vertex = after[vertex].pop()
            loops.append(loop)
    return sorted(loops, key=len)


def length_of(loop):
    """Of a loop that is a list of points."""
    return sum(map(math.dist, loop, loop[1:] + loop[:1]))


def to_segment(p, a, b):
    along = [y - x for x, y in zip(a, b)]
    length_sq = sum(x * x for x in along)
    t = sum((x - y) * z for x, y, z in zip(p, a, along)) / length_sq if length_sq else 0
    return math.dist(p, [x + min(max(t, 0), 1) * y for x, y in zip(a, along)])


def distances(points, loops):
    """From each point to the nearest segment of the loops, which are lists of points."""
    segments = [segment for loop in loops for segment in zip(loop, loop[1:] + loop[:1])]
    return [min((to_segment(point, *segment) for segment in segments), default=math.inf) for point in points]
