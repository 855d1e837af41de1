/* libwhittle: point clouds made small, with their features kept, and meshes of them.  The public header.
 *
 *     struct whittle_error error;
 *     struct whittle_cloud *cloud = NULL;
 *     struct whittle_options *options = whittle_options_new();
 *     struct whittle_result *result = NULL;
 *     if (whittle_cloud_from_positions(xyz, count, &cloud, &error) ||
 *         whittle_options_set(options, "ratio", "0.1", &error) ||
 *         whittle_options_set(options, "outputs", "cloud,mesh", &error) ||
 *         whittle_simplify(cloud, options, NULL, &result, &error))
 *         fprintf(stderr, "%s: %s\n", error.where, error.text);
 *
 * Conventions.
 *  - Handles are opaque.  x_new and functions with a `struct x **` argument return new handles, to be given to x_free,
 *    which accepts NULL.  Everything else is borrowed: pointers that a handle gives out live as long as the handle.
 *  - What can fail returns enum whittle_status (0 is success) and fills *error, which may be NULL, on the caller's
 *    stack.  Outputs are untouched on failure.
 *  - Nothing is global: handles may be used in any threads, one handle in one thread at a time, except that a cloud and
 *    options may be read by several calls of whittle_simplify at once.  The library never prints, exits, changes the
 *    locale or reads the environment; numbers in values of options and in files have a point, whatever the locale.
 *  - Indices are uint32_t; positions are double, in the units of the input; triangles are counter-clockwise seen from
 *    outside.
 *  - Results are the same to the bit for any number of threads.
 *  - Meshes are made by exact numbers of GMP, which ends the process where malloc has nothing for one, unless the
 *    program has given it functions of its own (mp_set_memory_functions).
 *
 * Works with C11 and C++; needs nothing but this header and -lwhittle (pkg-config: whittle).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_H
#define WHITTLE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__GNUC__)
#define WHITTLE_API __attribute__((visibility("default")))
#define WHITTLE_MUST_CHECK __attribute__((warn_unused_result))
#else
#define WHITTLE_API
#define WHITTLE_MUST_CHECK
#endif

/* The version of the library, e.g. "1.4.0".  Static text. */
WHITTLE_API const char *whittle_version(void);

/* ---------------------------------------------------------------------------------------------------- errors */

/* A list that only grows at its end. */
enum whittle_status {
    WHITTLE_OK = 0,
    WHITTLE_NO_MEMORY,     /* an allocation failed */
    WHITTLE_IO,            /* the operating system refused to read or to write */
    WHITTLE_UNSUPPORTED,   /* the content is of no format that is known */
    WHITTLE_MALFORMED,     /* the content breaks its format; line or byte_offset say where */
    WHITTLE_DEGENERATE,    /* too few distinct points, or all on one line or plane where a mesh is asked for */
    WHITTLE_BAD_PARAMETER, /* an option or an argument is unknown, out of range, or in conflict with another one */
    WHITTLE_LIMIT,         /* over a limit: too many points, tetrahedra, attributes */
    WHITTLE_CANCELLED,     /* the progress callback asked to stop */
    WHITTLE_ENGINE,        /* a fault of the library */
    WHITTLE_NO_SPACE       /* the disk or a quota is used up */
};

struct whittle_error {
    enum whittle_status code;
    uint64_t line;        /* from 1; 0: not known */
    uint64_t byte_offset; /* from 0; UINT64_MAX: not known */
    char where[64];       /* a stage, an option or an attribute */
    char text[320];       /* a sentence in English, without a full stop */
};

/* Lower-case name, e.g. "malformed".  Static text; "unknown" outside the list. */
WHITTLE_API const char *whittle_status_name(enum whittle_status status);

/* Called in the thread of the call that it was given to, each few milliseconds of work; stage is a name such as
 * "contract", fraction is of the whole call, 0 to 1.  A nonzero answer cancels: the call returns WHITTLE_CANCELLED. */
struct whittle_progress {
    int (*tick)(void *context, const char *stage, double fraction);
    void *context;
};

/* ---------------------------------------------------------------------------------------------------- clouds */

struct whittle_cloud;

enum whittle_type {
    WHITTLE_INT8,
    WHITTLE_UINT8,
    WHITTLE_INT16,
    WHITTLE_UINT16,
    WHITTLE_INT32,
    WHITTLE_UINT32,
    WHITTLE_FLOAT32,
    WHITTLE_FLOAT64
};

/* One value for each point: a column.  Colours are red, green, blue; normals nx, ny, nz. */
struct whittle_attribute {
    const char *name; /* printable ASCII without blanks, at most 63 bytes */
    enum whittle_type type;
    const void *values;  /* of the first point; native byte order, any alignment */
    size_t stride_bytes; /* from one point to the next; 0: the size of the type */
};

/* A cloud of count points (1 to 2^32 - 2), each with these attributes, of which x, y and z must be three and finite.
 * Copies everything.  O(count * attributes). */
WHITTLE_API enum whittle_status whittle_cloud_new(size_t count, const struct whittle_attribute *attributes,
                                                  size_t attribute_count, struct whittle_cloud **cloud,
                                                  struct whittle_error *error) WHITTLE_MUST_CHECK;

/* The same with positions alone: xyz holds count triples. */
WHITTLE_API enum whittle_status whittle_cloud_from_positions(const double *xyz, size_t count,
                                                             struct whittle_cloud **cloud,
                                                             struct whittle_error *error) WHITTLE_MUST_CHECK;

/* Gives the cloud the triangles of its own surface (corners: 3 * count indices of points), against which errors are
 * measured.  Replaces those that it has; copies. */
WHITTLE_API enum whittle_status whittle_cloud_set_triangles(struct whittle_cloud *cloud, const uint32_t *corners,
                                                            size_t count,
                                                            struct whittle_error *error) WHITTLE_MUST_CHECK;

/* Reads a file of any format that whittle knows, told by its content.  columns says what the columns of a text are, as
 * the option of that name does ("-,x,y,z", "x:east,y:north,z:4"); NULL or "" where its first line says so, or where
 * x, y and z are the first three.  WHITTLE_MALFORMED where they are given and the file isn't text.  progress may be
 * NULL. */
WHITTLE_API enum whittle_status whittle_cloud_read(const char *path, const char *columns,
                                                   const struct whittle_progress *progress,
                                                   struct whittle_cloud **cloud,
                                                   struct whittle_error *error) WHITTLE_MUST_CHECK;

/* The same from n bytes in memory. */
WHITTLE_API enum whittle_status whittle_cloud_read_memory(const void *bytes, size_t n, const char *columns,
                                                          const struct whittle_progress *progress,
                                                          struct whittle_cloud **cloud,
                                                          struct whittle_error *error) WHITTLE_MUST_CHECK;

WHITTLE_API void whittle_cloud_free(struct whittle_cloud *cloud);

WHITTLE_API size_t whittle_cloud_count(const struct whittle_cloud *cloud);
WHITTLE_API size_t whittle_cloud_attribute_count(const struct whittle_cloud *cloud);

/* Attribute i < attribute_count: its name, type, and the values of all points, interleaved with the others.  Lists
 * (which PLY has) have values NULL. */
WHITTLE_API struct whittle_attribute whittle_cloud_attribute(const struct whittle_cloud *cloud, size_t i);

/* count triples of coordinates. */
WHITTLE_API const double *whittle_cloud_positions(const struct whittle_cloud *cloud);

/* 3 * *count indices of points: the cloud's own triangles; NULL where it has none. */
WHITTLE_API const uint32_t *whittle_cloud_triangles(const struct whittle_cloud *cloud, size_t *count);

/* ---------------------------------------------------------------------------------------------------- options */

struct whittle_options;

/* All defaults.  NULL where memory runs out. */
WHITTLE_API struct whittle_options *whittle_options_new(void);
WHITTLE_API void whittle_options_free(struct whittle_options *options);

/* Sets one option by its name and as text: the names, ranges and defaults are those of the command line and of the
 * service (`whittle --help`, /v1/parameters); 10% is 0.1, and 10k is 10000.  WHITTLE_BAD_PARAMETER says what is
 * allowed; conflicts between options are found by whittle_simplify.  Those of files (columns, encoding, colours,
 * pcd_precision, header) change nothing here. */
WHITTLE_API enum whittle_status whittle_options_set(struct whittle_options *options, const char *name,
                                                    const char *value, struct whittle_error *error) WHITTLE_MUST_CHECK;

/* Bounds the memory of whittle_simplify, as a whole process with nothing else in it: where a mesh has more tetrahedra
 * than there is room for it ends with WHITTLE_NO_MEMORY.  0, the default: no bound. */
WHITTLE_API void whittle_options_set_memory(struct whittle_options *options, uint64_t bytes);

/* What there is to set.  All texts are static. */
struct whittle_option {
    const char *name;
    const char *default_text; /* "": not given */
    const char *unit;         /* "": none */
    const char *help;         /* a sentence */
};

/* Option i; false, and *option untouched, where i is past the last one. */
WHITTLE_API int whittle_option_at(size_t i, struct whittle_option *option);

/* Describes what option i takes, e.g. "a number over 0, at most 1", in text; "" past the last one. */
WHITTLE_API void whittle_option_allowed(size_t i, char *text, size_t text_bytes);

/* ---------------------------------------------------------------------------------------------------- results */

struct whittle_result;

/* Predicted peak memory in bytes of whittle_simplify for so many points with record_bytes of attributes each;
 * UINT64_MAX where the options conflict.  The mesh of points along lines takes more, up to 28 kB for each point of it:
 * whittle_options_set_memory is the bound for that. */
WHITTLE_API uint64_t whittle_memory(uint64_t points, uint64_t record_bytes, const struct whittle_options *options);

/* Simplifies.  Which results there are is what the option "outputs" says: kept points always, meshes with "mesh",
 * the operator with "dso", distances with "error".  options NULL: all defaults.  The cloud is borrowed for the call and
 * must outlive the result. */
WHITTLE_API enum whittle_status whittle_simplify(const struct whittle_cloud *cloud,
                                                 const struct whittle_options *options,
                                                 const struct whittle_progress *progress,
                                                 struct whittle_result **result,
                                                 struct whittle_error *error) WHITTLE_MUST_CHECK;

WHITTLE_API void whittle_result_free(struct whittle_result *result);

/* Number of levels, the finest first: 1 unless the option "levels" was set. */
WHITTLE_API size_t whittle_result_levels(const struct whittle_result *result);

/* The points that a level keeps: *count ids into the cloud, the most important first where a cloud is among the
 * outputs.  The ids of a level are the first of those of the finest one. */
WHITTLE_API const uint32_t *whittle_result_kept(const struct whittle_result *result, size_t level, size_t *count);

/* Where denoising puts the points of the cloud: triples for all of them; NULL where it moved none. */
WHITTLE_API const double *whittle_result_moved(const struct whittle_result *result);

/* The mesh of a level: *count triples of positions; 3 * *count corners, which are indices of its vertices; the id of
 * the point of the cloud that each vertex stands for, UINT32_MAX where it was moved freely.  NULL and 0 without one. */
WHITTLE_API const double *whittle_result_vertices(const struct whittle_result *result, size_t level, size_t *count);
WHITTLE_API const uint32_t *whittle_result_triangles(const struct whittle_result *result, size_t level, size_t *count);
WHITTLE_API const uint32_t *whittle_result_sources(const struct whittle_result *result, size_t level);

/* The unit normal of every point of the cloud, triples, where the option "normals" is "true" and the cloud has none of
 * its own that fit its points; else NULL.  With "crop" and "where", (0, 0, 0) at points that these leave out. */
WHITTLE_API const float *whittle_result_normals(const struct whittle_result *result);

/* The discrete shape operator at every point of the cloud, in 1 / length, and the distance of every point to the finest
 * mesh; NULL unless asked for.  0 at points that "crop" and "where" leave out. */
WHITTLE_API const float *whittle_result_operator(const struct whittle_result *result);
WHITTLE_API const float *whittle_result_distances(const struct whittle_result *result);

/* A figure of the report by name, such as "points_in" or, of a level, "error.symmetric.max"; lengths are in the units
 * of the input.  False, and *value untouched, where the name is unknown or nothing of the kind was measured. */
WHITTLE_API int whittle_result_number(const struct whittle_result *result, size_t level, const char *name,
                                      double *value);

/* The name of figure i of the report; NULL past the last one. */
WHITTLE_API const char *whittle_result_number_name(size_t i);

/* Writes the i-th thing (from 0) that is to be known before a level's results are used, a sentence without a full stop,
 * into text (320 bytes hold any); false, and text untouched, where there is no i-th one. */
WHITTLE_API int whittle_result_warning(const struct whittle_result *result, size_t level, size_t i, char *text,
                                       size_t text_bytes);

/* The i-th thing that the cloud couldn't hold of the input: a sentence; NULL past the last one. */
WHITTLE_API const char *whittle_result_left_out(const struct whittle_result *result, size_t i);

#ifdef __cplusplus
}
#endif

#endif
