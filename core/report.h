/* What a job measured: counts, errors, times.  Plain numbers; api/ turns them into JSON.
 *
 * Lengths are in the input's own units; x_rel = x / diagonal, the diagonal of the original bounding box.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REPORT_H
#define WHITTLE_CORE_REPORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/left_out.h"
#include "core/params.h"

/* Distances of samples to a surface.  count == 0: not measured. */
struct distance_stats {
    uint64_t count;
    double mean, rms, max;
};

enum { REPORT_MAX_STAGES = 24, REPORT_STAGE_BYTES = 24, REPORT_WARNING_BYTES = 320 };

struct report_stage {
    char name[REPORT_STAGE_BYTES];
    double wall_ms;
};

/* One simplified cloud, and its mesh where one is asked for. */
struct report_level {
    double ratio; /* points_out / points_in */
    uint64_t points_out;
    double contraction_error;      /* largest sqrt(E / W) of the quadrics of the contractions made: a length */
    struct distance_stats tangent; /* without a mesh: every original point to the tangent plane at its nearest kept
                                      point */

    bool has_mesh;
    uint64_t vertices, triangles, hole_fill_triangles, components;
    uint64_t points_lost;        /* kept points that are no vertex */
    uint64_t vertices_split;     /* copies made to keep it a manifold */
    uint64_t holes_closed;       /* of a mesh with borders, because they were asked for */
    uint64_t reconstructed_from; /* points that the surface went through before edges were collapsed */
    uint64_t handles, borders;   /* 0 handles unless it is manifold and oriented */
    uint64_t self_intersections; /* pairs of triangles (core/mesh/intersect.h) */
    double border_length;
    bool watertight, manifold, oriented;
    double area, volume;     /* volume: NAN unless it is watertight */
    double unsupported;      /* share of the area that no input point supports (core/measure/support.h) */
    char reconstruction[24]; /* which form was taken: "tight", "literal", ..., "given" */

    bool has_error;
    struct distance_stats input_to_mesh;   /* every original point to the mesh */
    struct distance_stats mesh_to_input;   /* the mesh's surface to the reference */
    struct distance_stats surface_to_mesh; /* the reference's surface to the mesh; count 0 without one */
    struct distance_stats symmetric;       /* both ways alike: means of surface_to_mesh, or input_to_mesh where there is
                                              none, and mesh_to_input; its max is the Hausdorff distance */
    struct distance_stats dropped; /* every point that denoising dropped to the mesh: in none of the others; count
                                      0 = there are none */
    char reference[24];            /* what mesh_to_input was measured against: "points", "faces", "reconstruction" */
};

/* The largest distance of an input point to the result, or of a share of them: to the mesh where there is one, else to
 * the tangent planes. */
struct report_deviation {
    double bound, reached; /* bound: what was asked for; 0 = nothing; reached: by the share of the points */
    double share;          /* of the points that are to be within the bound */
    uint64_t points_over;  /* that are not */
    uint64_t tried;        /* counts of points that the search made results of */
};

/* Of the points' normals. */
struct report_normals {
    bool known;           /* they were looked at */
    bool given;           /* the input's own fit its points */
    char orientation[16]; /* what says which way they point: "normals" that were given, "viewpoint", "upwards",
                             "outwards", or of a mesh what its surface's says; "" where they aren't written */
};

/* What was asked for of distances between kept points; spacing 0 = nothing. */
struct report_spacing {
    double spacing;
    uint64_t points; /* that have room with it */
    bool at_least;   /* nobody has looked whether more have */
};

/* What the cloud was taken for, once for all meshes.  "" where there are none. */
struct report_surface {
    char kind[16];        /* "closed", "open", "heightfield", "given" */
    char reason[200];     /* a sentence without a full stop */
    char orientation[16]; /* what says which side is in front: "outwards", "inwards", "upwards", "normals", "viewpoint",
                             "scan pattern", "faces" */
    bool sure;
};

struct report {
    uint64_t points_in, points_distinct, points_outliers /* of points_in, dropped by denoising */;
    uint64_t points_cropped, points_filtered; /* that weren't asked for (core/cloud/select.h), beside points_in */
    double noise; /* standard deviation of the points from the surface that they were smoothed to; 0: they weren't */
    double noisy_share; /* of the places that were looked at: those where noise exceeds half the distance between points
                           (core/clean/shell.h); 0: it wasn't looked for */
    bool strays_sought; /* without being asked for, since a mesh has spikes of them (core/clean/outliers.h) */
    char denoised[16];  /* what was done: "none", "outliers", "layers" (those and the less exact of two), "full" */
    double noise_level; /* estimated, of the points that are simplified (core/clean/noise.h) */
    double noise_share; /* of the median distance between neighbours; 0 where the cloud was denoised */
    double rounding_step, rounding_share; /* of coordinates (core/cloud/cloud.h), and of that distance */
    double diagonal; /* of the bounding box of all points read, or where they are denoised of those that were left */
    double box_min[3], box_max[3];
    char format[32]; /* of the input, e.g. "ply/binary_little_endian" */

    size_t level_count;
    struct report_level level[PARAMS_MAX_LEVELS]; /* the finest first; that is the one of cloud.ply and mesh.ply */

    struct report_normals normals;
    struct report_spacing spacing;
    struct report_surface surface;
    struct report_deviation deviation;

    struct left_out left_out; /* what the cloud doesn't hold of the input, and the outputs not of the cloud */

    size_t stage_count;
    struct report_stage stage[REPORT_MAX_STAGES];
    double total_ms;
    uint64_t peak_rss_bytes;
};

/* Adds a stage's time; a name that is there already is added to.  Past REPORT_MAX_STAGES it is dropped. */
void report_add_stage(struct report *report, const char *name, double wall_ms);

/* Sets level->symmetric by the three directions. */
void report_set_symmetric(struct report_level *level);

/* A closed mesh of which more than this share of the area is unsupported closes what wasn't scanned, and is told of. */
#define REPORT_UNSUPPORTED_MOST 0.05

/* One with borders that has more than this share of it is told of: scans have up to .04, wires .9. */
#define REPORT_WEBS_MOST 0.5

/* From this share of the distance between points on, a mesh of kept points shows the noise more than the surface, and
 * smoothing pays: measured on two statues with noise and doubles of many levels, and on six scans. */
#define REPORT_LARGE_NOISE 0.125

/* Coordinates whose steps are this share of the distance between points show a surface of steps. */
#define REPORT_COARSE_STEPS 0.2

/* A cloud that is so many times as high as wide may have degrees below metres, and is told of: 5 m of height over 2 km
 * are 280 times. */
#define REPORT_NEEDLE 200

/* Writes the n-th thing (from 0) that a user should know before using this level of the report's results, as a sentence
 * without a full stop; false where there is no n-th one. */
bool report_warning(const struct report *report, const struct report_level *level, size_t n, char *text,
                    size_t text_bytes);

#endif
