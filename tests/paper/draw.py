"""Pictures of clouds and meshes: a rasteriser of a page of numpy, and matplotlib for panels, labels and curves.

Everything is drawn in orthographic projection with one light beside the viewer.  A mesh is rasterised with a depth
buffer at twice the resolution and averaged down.  Points are drawn over the true surface and only where that surface
doesn't hide them, so that their distribution can be seen.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import matplotlib

matplotlib.use("Agg")
# pylint: disable=wrong-import-position
import matplotlib.pyplot as plot
import numpy as np

FINE = 2  # pixels drawn for each pixel shown, along each axis
PALE = (0.93, 0.92, 0.89)
CLAY = (0.80, 0.78, 0.74)
LIGHT = np.array([0.35, 0.45, 0.82])  # right, up, to the viewer
AMBIENT, UNDER_POINTS = 0.4, 0.72  # the darkest shade of a mesh, and of a surface below points
CHUNK = 4_000_000  # candidate pixels at a time

# The viewer's right and up; others are seen from a corner, y up.
VIEWS = {"horse": ((0.1, 1, 0), (0, 0, 1)), "venus": ((0.5, 0.87, 0), (0, 0, 1)),
         "armadillo": ((-0.9, 0, 0.45), (0, 1, 0)), "samp53g": ((0.9, 0.43, 0), (-0.3, 0.5, 0.8)),
         "autzen_trim": ((0.9, 0.43, 0), (-0.3, 0.5, 0.8)), "lion": ((1, 0, 0), (0, 1, 0)),
         "frag2": ((-1, 0, 0), (0, -1, 0)), "mosd10": ((-1, 0, 0.3), (0, -1, -0.3)), "range1": ((1, 0, 0), (0, 1, 0))}
CORNER = ((0.87, 0, -0.5), (0.1, 0.97, 0.2))


class Camera:
    """Where points of a model lie in a picture of so many pixels on its longer side."""

    def __init__(self, name, xyz, pixels):
        right, up = (np.array(v, float) for v in VIEWS.get(name, CORNER))
        right /= np.linalg.norm(right)
        up -= right * (up @ right)
        up /= np.linalg.norm(up)
        self.axes = np.array([right, up, np.cross(right, up)])
        seen = xyz @ self.axes.T
        low, high = seen.min(0), seen.max(0)
        self.diagonal = np.linalg.norm(high - low)
        self.scale = pixels * 0.96 / max(high[0] - low[0], high[1] - low[1])
        self.size = np.ceil((high - low)[:2] * self.scale / 0.96).astype(int)  # width, height
        self.centre = (low + high) / 2

    def look(self, xyz):
        """Columns, rows (as real numbers) and heights towards the viewer."""
        seen = (xyz @ self.axes.T - self.centre) * self.scale
        return np.column_stack([seen[:, 0] + self.size[0] / 2, self.size[1] / 2 - seen[:, 1], seen[:, 2]])


def face_normals(xyz, faces):
    a, b, c = xyz[faces[:, 0]], xyz[faces[:, 1]], xyz[faces[:, 2]]
    return np.cross(b - a, c - a)


def unit(vectors):
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths == 0, 1, lengths)


def vertex_normals(xyz, faces):
    normals, of_faces = np.zeros_like(xyz), face_normals(xyz, faces)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], of_faces)
    return unit(normals)


def fragments(seen, faces):
    """Yields for chunks of faces: face, row, column, and barycentric coordinates of each covered pixel."""
    corner = seen[faces][:, :, :2]
    low = np.floor(corner.min(1)).astype(int)
    extent = np.ceil(corner.max(1)).astype(int) - low + 1
    counts = extent[:, 0] * extent[:, 1]
    ends = np.cumsum(counts)
    first = 0
    while first < len(faces):
        last = max(first + 1, int(np.searchsorted(ends, ends[first] - counts[first] + CHUNK)))
        ids = np.repeat(np.arange(first, last), counts[first:last])
        offset = np.arange(len(ids)) - np.repeat(np.cumsum(counts[first:last]) - counts[first:last], counts[first:last])
        pixel = np.column_stack([low[ids, 0] + offset % extent[ids, 0], low[ids, 1] + offset // extent[ids, 0]])
        yield inside(ids, pixel, corner)
        first = last


def inside(ids, pixel, corner):
    a, ab, ac = corner[ids, 0], corner[ids, 1] - corner[ids, 0], corner[ids, 2] - corner[ids, 0]
    ap = pixel + 0.5 - a
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    area[area == 0] = np.inf
    v = (ap[:, 0] * ac[:, 1] - ap[:, 1] * ac[:, 0]) / area
    w = (ab[:, 0] * ap[:, 1] - ab[:, 1] * ap[:, 0]) / area
    keep = (v >= -1e-6) & (w >= -1e-6) & (v + w <= 1 + 1e-6) & np.isfinite(area)
    weights = np.column_stack([1 - v - w, v, w])[keep]
    return ids[keep], pixel[keep, 1], pixel[keep, 0], weights


def rasterise(camera, xyz, faces, normals, colours, ambient=AMBIENT):
    """(picture, heights); normals and colours are those of the corners, faces x 3 x 3.  No surface: white, -inf."""
    seen = camera.look(xyz) * FINE
    width, height = camera.size * FINE
    depth = np.full(width * height, -np.inf)
    picture = np.ones((width * height, 3))
    for ids, row, column, weights in fragments(seen, faces):
        keep = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        ids, weights, pixel = ids[keep], weights[keep], (row * width + column)[keep]
        high = np.einsum("ij,ij->i", weights, seen[faces[ids], 2])
        np.maximum.at(depth, pixel, high)
        top = high >= depth[pixel]
        ids, weights, pixel = ids[top], weights[top], pixel[top]
        normal = unit(np.einsum("ij,ijk->ik", weights, normals[ids])) @ camera.axes.T
        normal *= np.where(normal[:, 2:] < 0, -1, 1)
        shade = ambient + (1 - ambient) * np.clip(normal @ LIGHT / np.linalg.norm(LIGHT), 0, 1)
        picture[pixel] = np.einsum("ij,ijk->ik", weights, colours[ids]) * shade[:, None]
    return picture.reshape(height, width, 3), depth.reshape(height, width) / FINE


def average(picture):
    height, width = picture.shape[0] // FINE, picture.shape[1] // FINE
    return picture[:height * FINE, :width * FINE].reshape(height, FINE, width, FINE, 3).mean((1, 3))


def draw_mesh(camera, xyz, faces, colour=CLAY, smooth=False, face_colour=None):
    """A picture of a mesh; colour is one, or one for each vertex; face_colour one for each face.  Flat shading shows the
    triangles."""
    if smooth:
        normals = vertex_normals(xyz, faces)[faces]
    else:
        normals = np.repeat(face_normals(xyz, faces)[:, None], 3, axis=1)
    colours = np.broadcast_to(colour, xyz.shape)[faces] if face_colour is None else face_colour[:, None].repeat(3, 1)
    return average(rasterise(camera, xyz, faces, normals, colours)[0])


def draw_points(camera, surface, points, radius):
    """(picture of the surface, columns and rows of the points that it doesn't hide)."""
    xyz, faces = surface
    picture, heights = rasterise(camera, xyz, faces, vertex_normals(xyz, faces)[faces],
                                 np.broadcast_to(PALE, xyz.shape)[faces], UNDER_POINTS)
    seen = camera.look(points)
    column, row = (np.clip((seen[:, axis] * FINE).astype(int), 0, heights.shape[1 - axis] - 1) for axis in (0, 1))
    near = seen[:, 2] >= heights[row, column] - 0.004 * camera.diagonal * camera.scale
    order = np.argsort(seen[near, 2])
    return average(picture), seen[near][order][:, :2], radius


# ---------------------------------------------------------------------------------------------------- figures
def panels(path, pictures, titles, rows=1, caption=None):
    """Pictures side by side.  A picture is an image, or what draw_points returned."""
    columns = (len(pictures) + rows - 1) // rows
    first = pictures[0][0] if isinstance(pictures[0], tuple) else pictures[0]
    aspect = first.shape[0] / first.shape[1]
    width = min(4.2, 13 / columns)
    figure, axes = plot.subplots(rows, columns, squeeze=False,
                                 figsize=(width * columns, rows * (width * aspect + 0.35)))
    for axis in axes.flat:
        axis.axis("off")
    for axis, picture, title in zip(axes.flat, pictures, titles):
        if isinstance(picture, tuple):
            axis.imshow(picture[0])
            axis.scatter(*picture[1].T, s=picture[2] ** 2, c="#a3231f", linewidths=0)
        else:
            axis.imshow(np.clip(picture, 0, 1))
        axis.set_title(title, fontsize=10)
    if caption:
        figure.text(0.5, 0.005, caption, ha="center", fontsize=8)
    figure.tight_layout(pad=0.4)
    figure.savefig(path, dpi=130)
    plot.close(figure)


def curves(path, series, title, ylabel):
    """series: [(label, style, {kept in %: value})] on a logarithmic scale."""
    figure, axis = plot.subplots(figsize=(6, 4))
    kept = sorted({x for _, _, values in series for x in values}, reverse=True)
    for label, style, values in series:
        axis.plot([kept.index(x) for x in values], list(values.values()), style, label=label, markersize=5)
    axis.set_xticks(range(len(kept)), [f"{x:g} %" for x in kept])
    axis.set_yscale("log")
    axis.set_xlabel("points kept")
    axis.set_ylabel(ylabel)
    axis.set_title(title, fontsize=11)
    axis.grid(True, which="both", alpha=0.25)
    axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=130)
    plot.close(figure)


def bars(path, groups, series, title, ylabel):
    """series: {label: one value for each group}."""
    figure, axis = plot.subplots(figsize=(max(6, 0.62 * len(groups) * len(series) + 1), 3.6))
    width = 0.8 / len(series)
    for i, (label, values) in enumerate(series.items()):
        axis.bar(np.arange(len(groups)) + (i - (len(series) - 1) / 2) * width, values, width, label=label)
    axis.set_xticks(range(len(groups)), groups, fontsize=8)
    axis.set_ylabel(ylabel)
    axis.set_title(title, fontsize=11)
    axis.legend(fontsize=8)
    axis.grid(True, axis="y", alpha=0.25)
    figure.tight_layout()
    figure.savefig(path, dpi=130)
    plot.close(figure)
