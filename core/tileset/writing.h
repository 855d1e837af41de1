/* A tileset while it is being written: tree after tree, each of which is a part of the whole.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILESET_WRITING_H
#define WHITTLE_CORE_TILESET_WRITING_H

#include "core/io/out/file_out.h"
#include "core/io/out/mesh_attributes.h"
#include "core/io/out/sink.h"
#include "core/mesh/mesh.h"
#include "core/tileset/archive.h"
#include "core/tileset/octree.h"
#include "core/tileset/tileset.h"

enum { WRITING_ABREAST = 16 /* tiles that are made before they are written */ };

/* Where files go. */
struct writing_target {
    struct archive *archive; /* or */
    const char *folder;
    struct file_out file[WRITING_ABREAST]; /* of the folder, without their names yet */
    size_t files;
};

struct writing {
    const struct tileset_points *points;
    struct writing_target *target;
    struct left_out *left_out;
    struct error *error;
    vec3 origin;
    double colour_scale; /* of all points; 0: of the present tree's */
    size_t nodes, nodes_room;
    struct octree_node *node; /* of all trees until now, the tiles of these numbers; owned */
    struct octree tree;       /* the present one */
    struct mesh_attributes attributes;
    struct mesh all; /* its sources are the tree's points */
    struct sink glb[WRITING_ABREAST];
    size_t first; /* of the present tree's tiles that are made beside each other now, by these statuses */
    enum status made[WRITING_ABREAST];
    double moved[WRITING_ABREAST], most_moved; /* of these and of all: how far off rounding puts a point's coordinate */
};

/* Writes the tiles of w->tree, whose errors are known, and adds its nodes.  id: of each rank's point, in the cloud. */
enum status writing_put_tree(struct writing *w, const struct cloud *cloud, const uint32_t *id) MUST_CHECK;

enum status writing_no_memory(const struct writing *w);

/* Everything of w->points->file, in trees that fit into memory.  core/tileset/parts.c */
enum status parts_put(struct writing *w) MUST_CHECK;

#endif
