/* What a mesh's vertices have from the points that they stand for: normals, colours and texture coordinates, for
 * formats that know these.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_MESH_ATTRIBUTES_H
#define WHITTLE_CORE_IO_OUT_MESH_ATTRIBUTES_H

#include <stdbool.h>
#include <stddef.h>

#include "core/base/left_out.h"
#include "core/cloud/cloud.h"
#include "core/mesh/mesh.h"

struct mesh_attributes {
    const struct mesh *mesh;           /* borrowed */
    const struct cloud *cloud;         /* borrowed; NULL: some vertex has no point, so there are no attributes */
    const struct property *normal[3];  /* nx, ny, nz; all NULL where there are none */
    const struct property *colour[4];  /* red, green, blue, alpha; likewise, or if all are 0; alpha may be NULL alone */
    const struct property *texture[2]; /* s, t; likewise */
    double colour_scale;               /* what a colour's number is multiplied by to lie in 0 .. 1 */
};

/* cloud may be NULL.  O(vertices). */
void mesh_attributes_find(const struct mesh *mesh, const struct cloud *cloud, struct mesh_attributes *attributes);

/* The record of vertex v's point; only where attributes->cloud isn't NULL. */
const unsigned char *mesh_attributes_record(const struct mesh_attributes *attributes, size_t v);

/* The normal of vertex v as it is in the cloud, where there are normals. */
vec3 mesh_attributes_normal(const struct mesh_attributes *attributes, size_t v);

/* Its texture coordinates, where there are any. */
void mesh_attributes_texture(const struct mesh_attributes *attributes, size_t v, double st[2]);

/* Its colour and opacity, each 0 .. 1, where there are colours. */
void mesh_attributes_colour(const struct mesh_attributes *attributes, size_t v, double rgba[4]);

/* Whether a property is among the normals, colours and texture coordinates that were found. */
bool mesh_attributes_knows(const struct mesh_attributes *attributes, const struct property *property);

/* Whether all vertices' coordinates are exactly float32. */
bool mesh_attributes_fit_f32(const struct mesh *mesh);

/* How far float32 around this origin is off a coordinate of a vertex, at most. */
double mesh_attributes_f32_error(const struct mesh *mesh, vec3 origin);

/* Notes under `where` all properties that keeps (NULL = none) doesn't claim and that aren't positions, and that the
 * fills of holes aren't told apart unless tags are kept. */
void mesh_attributes_note(const struct mesh_attributes *attributes, const struct cloud *cloud, const char *where,
                          bool (*keeps)(const struct mesh_attributes *attributes, const struct property *property),
                          bool keeps_tags, struct left_out *left_out);

#endif
