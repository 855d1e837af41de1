/* The faces that an input comes with, as a surface through the distinct points.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_GIVEN_FACES_H
#define WHITTLE_CORE_SURFACE_GIVEN_FACES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/cloud/morton.h"
#include "core/mesh/mesh.h"

/* Which triangles of a cloud count: left_out[t] becomes 1 of those without an area, or, where flat ones are kept, of
 * those with two corners at one place; and of all but the first of those whose corners are at the same places.
 * *flat and *repeated = how many of either.  O(triangles).  STATUS_NO_MEMORY. */
enum status faces_sort_out(const struct cloud *cloud, const struct ordered_points *points, bool keep_flat,
                           unsigned threads, uint8_t *left_out, size_t *flat, size_t *repeated) MUST_CHECK;

struct faces {
    size_t count;
    uint32_t (*triangle)[3]; /* ids along the curve, in the order of the lowest of each; owned */
    uint32_t (*record)[3];   /* of each corner which point of the cloud it is, of several at the place: equal where
                                their attributes are; NULL = there are no seams; owned */
    uint8_t *on_seam;        /* of each point along the curve, 1 where several fans meet, too; NULL as record; owned */
};

struct faces_facts {
    size_t flat, repeated; /* triangles that don't count */
    size_t turned;         /* that faced against those beside them, and were turned over */
    size_t used, knotted;  /* points that faces have; those of them where several fans of faces meet */
    size_t borders, seams; /* edges with one triangle; edges across which attributes differ */
    bool seams_dropped;    /* there were so many that nothing would be left to simplify */
};

/* Makes the surface: triangles that count, of each connected set turned as most of them face, as far as a side can be
 * told.  Corners at one place are one vertex; where they differ in texture coordinates, or normals, is a seam.  The
 * same for any number of threads.  O(triangles log triangles).  STATUS_NO_MEMORY. */
enum status faces_make(const struct cloud *cloud, const struct ordered_points *points, unsigned threads,
                       struct faces *faces, struct faces_facts *facts) MUST_CHECK;

/* Accepts zeroed ones. */
void faces_done(struct faces *faces);

/* A mesh of them, with the points' ids as sources; *mesh is the caller's.  STATUS_NO_MEMORY. */
enum status faces_mesh(const struct faces *faces, const struct ordered_points *points, struct mesh *mesh) MUST_CHECK;

/* Gives each vertex of a mesh a copy for each record that its corners (of record) have but the first: seams become
 * borders.  *of_vertex = the record of each vertex, the caller's.  STATUS_NO_MEMORY. */
enum status faces_cut(struct mesh *mesh, const uint32_t (*record)[3], uint32_t **of_vertex) MUST_CHECK;

#endif
