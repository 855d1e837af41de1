/* The parameters of a job: one struct, and one table that knows everything about each member.
 *
 * The table drives the query string, JSON, the command line, --help, the JSON Schema and the documents.  To add a
 * parameter: a member here, a row in params.c, and its use in the stage.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PARAMS_H
#define WHITTLE_CORE_PARAMS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/text/column_list.h"
#include "core/text/condition_list.h"
#include "core/text/name_list.h"
#include "core/text/weight_list.h"

enum dso_form { DSO_RMS, DSO_SUM, DSO_NONE };
/* auto: optimal where the input's own faces are simplified and have no texture coordinates, else subset. */
enum placement { PLACEMENT_SUBSET, PLACEMENT_OPTIMAL, PLACEMENT_AUTO };
enum area_weight { AREA_UNIT, AREA_AREA };
/* Whether points are simplified before the surface is reconstructed from them, or it is reconstructed from more. */
enum order { ORDER_AUTO, ORDER_SIMPLIFY_FIRST, ORDER_RECONSTRUCT_FIRST };
enum refine_form { REFINE_NONE, REFINE_FLIPS, REFINE_FULL };
/* What the points are of: the skin of solids; sheets with borders; one sheet seen from above; or of what the input's
 * faces are. */
enum surface_form { SURFACE_CLOSED, SURFACE_OPEN, SURFACE_HEIGHTFIELD, SURFACE_AUTO, SURFACE_GIVEN };
enum boundary_form { BOUNDARY_FILL, BOUNDARY_KEEP, BOUNDARY_AUTO };
enum reference_form { REFERENCE_AUTO, REFERENCE_POINTS, REFERENCE_FACES, REFERENCE_RECONSTRUCTION };
/* What is done to the points before all else. */
enum denoise_form { DENOISE_NONE, DENOISE_OUTLIERS, DENOISE_FULL, DENOISE_AUTO, DENOISE_NOISY };
enum encoding { ENCODING_BINARY, ENCODING_ASCII };
/* Bits of a colour's component in outputs. */
enum colour_bits { COLOURS_8, COLOURS_16, COLOURS_KEEP };
enum pcd_precision { PCD_FLOAT, PCD_DOUBLE };
/* Which axis of the input is upwards, in the order of core/picture/view.h. */
enum up { UP_AUTO, UP_X, UP_Y, UP_Z };
enum xyz_header { HEADER_NONE, HEADER_PLAIN, HEADER_HASH };
enum attribute_form { ATTRIBUTES_NEAREST, ATTRIBUTES_MEAN };
enum switch_form { SWITCH_FALSE, SWITCH_TRUE };

/* Bits of params.outputs, in the order of the table's choices. */
enum output {
    OUTPUT_CLOUD = 1 << 0,       /* cloud.ply */
    OUTPUT_CLOUD_XYZ = 1 << 1,   /* cloud.xyz */
    OUTPUT_MESH = 1 << 2,        /* mesh.ply */
    OUTPUT_REPORT = 1 << 3,      /* report.json */
    OUTPUT_DSO = 1 << 4,         /* dso.ply: the discrete shape operator of every original point */
    OUTPUT_ERROR = 1 << 5,       /* error.ply: the distance of every original point to the mesh */
    OUTPUT_CLOUD_PCD = 1 << 6,   /* cloud.pcd */
    OUTPUT_MESH_OBJ = 1 << 7,    /* mesh.obj */
    OUTPUT_MESH_STL = 1 << 8,    /* mesh.stl */
    OUTPUT_MESH_GLB = 1 << 9,    /* mesh.glb */
    OUTPUT_PREVIEW = 1 << 10,    /* preview.png */
    OUTPUT_CLOUD_LAS = 1 << 11,  /* cloud.las */
    OUTPUT_CLOUD_LAZ = 1 << 12,  /* cloud.laz */
    OUTPUT_TILESET = 1 << 13,    /* tileset.3tz, or tileset.json with its tiles */
    OUTPUT_CLOUD_COPC = 1 << 14, /* cloud.copc.laz */
    OUTPUT_ANY_TREE = OUTPUT_TILESET | OUTPUT_CLOUD_COPC,
    OUTPUT_ANY_LAS = OUTPUT_CLOUD_LAS | OUTPUT_CLOUD_LAZ | OUTPUT_CLOUD_COPC,
    OUTPUT_ANY_CLOUD = OUTPUT_CLOUD | OUTPUT_CLOUD_XYZ | OUTPUT_CLOUD_PCD | OUTPUT_ANY_LAS | OUTPUT_TILESET,
    OUTPUT_ANY_MESH = OUTPUT_MESH | OUTPUT_MESH_OBJ | OUTPUT_MESH_STL | OUTPUT_MESH_GLB
};
enum { PARAMS_OUTPUTS = 15, PARAMS_MAX_FILES = 64 /* that one job may write */ };

enum { PARAMS_MAX_LEVELS = 16 };
enum { PARAMS_ALIASES = 2, PARAMS_ALIAS_BYTES = 32 };

/* Ratios, descending, none twice. */
struct param_levels {
    uint32_t count;
    double ratio[PARAMS_MAX_LEVELS];
};

/* Bytes, with its NUL, that suffice for the text of any value. */
enum { PARAMS_TEXT_BYTES = 1024 };

/* A list of numbers, as they were given. */
enum { PARAMS_MAX_NUMBERS = 40 };
struct param_numbers {
    uint32_t count; /* 0 = not given */
    double value[PARAMS_MAX_NUMBERS];
};
/* How many: a place; a box (two corners), or more for the corners of a polygon in x and y. */
enum { PARAMS_PLACE_NUMBERS = 3, PARAMS_BOX_NUMBERS = 6 };

struct params {
    double ratio;                     /* (0, 1]; NAN = not given */
    uint64_t points;                  /* 0 = not given */
    double max_deviation;             /* in the input's units; NAN = not given */
    double max_deviation_rel;         /* fraction of the diagonal; NAN = not given; not both */
    double deviation_share;           /* (0, 1]: of the points that either of them is to hold for */
    double max_error;                 /* fraction of the diagonal; NAN = not given; deprecated */
    double spacing;                   /* in the input's units; NAN = not given */
    struct param_levels levels;       /* count 0 = not given: one level */
    struct param_numbers crop;        /* x0 y0 z0 x1 y1 z1, or x y x y ...: the corners of a polygon */
    char where[CONDITION_LIST_BYTES]; /* "" = not given */
    struct param_numbers viewpoint;   /* x y z */
    uint32_t outputs;                 /* enum output */
    int normals;                      /* enum switch_form: whether outputs have normals */
    int denoise;                      /* enum denoise_form */
    int placement;                    /* enum placement */
    int dso;                          /* enum dso_form */
    double dso_exponent;
    int area_weight; /* enum area_weight */
    double line_quadric;
    char weights[WEIGHT_LIST_BYTES]; /* of attributes; "" = not given */
    double neighbourhood;            /* Gopi's m */
    uint64_t neighbours_min, neighbours_max;
    int reconstruction;                        /* row of surface/reconstruct.h */
    int surface;                               /* enum surface_form */
    double close_holes;                        /* in the input's units; NAN = not given */
    int attributes;                            /* enum attribute_form */
    int order;                                 /* enum order */
    int boundary;                              /* enum boundary_form */
    int refine;                                /* enum refine_form */
    int reference;                             /* enum reference_form */
    int encoding;                              /* enum encoding of PLY outputs */
    int colours;                               /* enum colour_bits */
    int pcd_precision;                         /* enum pcd_precision */
    int header;                                /* enum xyz_header */
    int quantize, meshopt;                     /* enum switch_form: of glTF */
    char columns[COLUMN_LIST_BYTES];           /* of a text input; "" = not given */
    char properties[NAME_LIST_BYTES];          /* that outputs have; "" = all */
    uint64_t preview_size;                     /* pixels */
    double preview_azimuth, preview_elevation; /* degrees; azimuth NAN = not given */
    int up;                                    /* enum up: of pictures and glTF */
    uint64_t seed;                             /* of the error's samples */
    uint64_t threads;                          /* 0 = all processors */
    uint64_t memory_bytes;                     /* that the run may take, which its caller says: no row; 0 = no limit */

    /* What was given by deprecated names, as params_format writes it, "" = not given; and whether the present name was
     * given too, so that params_resolve sees where they differ. */
    struct param_alias_use {
        bool by_name;
        char value[PARAMS_ALIAS_BYTES];
    } alias[PARAMS_ALIASES];
};

/* Whether a mesh has to be made. */
static inline bool params_want_mesh(const struct params *params) {
    return params->outputs & (OUTPUT_ANY_MESH | OUTPUT_ERROR);
}

/* Whether points are removed only as long as the measured deviation allows it. */
static inline bool params_bound_deviation(const struct params *params) {
    return params->max_deviation > 0 || params->max_deviation_rel > 0; /* not NAN */
}

/* Whether points may be dropped or moved before all else.  What noise makes necessary is done for meshes alone. */
static inline bool params_want_denoising(const struct params *params) {
    if (params->denoise != DENOISE_NOISY) return params->denoise != DENOISE_NONE;
    return params_want_mesh(params);
}

enum param_type {
    PARAM_NUMBER,
    PARAM_INTEGER,
    PARAM_CHOICE,
    PARAM_FLAGS,
    PARAM_LEVELS,
    PARAM_COLUMNS,
    PARAM_NUMBERS,
    PARAM_CONDITIONS,
    PARAM_WEIGHTS,
    PARAM_NAMES
};

/* One row.  Numbers are double members, integers uint64_t, choices int, flags uint32_t, levels struct param_levels,
 * columns text of COLUMN_LIST_BYTES, lists of numbers struct param_numbers, conditions text of
 * CONDITION_LIST_BYTES, weights of WEIGHT_LIST_BYTES, names of NAME_LIST_BYTES. */
struct param {
    const char *name;
    enum param_type type;
    size_t offset;   /* of the member in struct params */
    double min, max; /* numbers and integers, both inclusive but for exclusive_min; flags: max is how many bits; lists
                        of numbers: how many there are at least and at most */
    bool exclusive_min;
    const char *default_text;   /* as a user would write it; "" = not given */
    const char *const *choices; /* choices: index = value; flags: index = bit, those beyond max are second
                                   names of the bits from 0 on; NULL-terminated */
    const char *unit;           /* "" = none */
    bool affects_result;        /* false: only how fast (threads) */
    const char *help;           /* one sentence */
};

/* A deprecated name of a parameter, accepted wherever its own is. */
struct param_alias {
    const char *name, *of;
};

/* The table; *count rows.  Never NULL. */
const struct param *params_table(size_t *count);

/* Deprecated names; *count rows.  Never NULL. */
const struct param_alias *params_aliases(size_t *count);

/* Whether another parameter has taken the place of this one, which stays accepted. */
bool params_is_deprecated(const struct param *param);

/* Whether it is one that most people need; the others are for those who know the method or a format. */
bool params_is_everyday(const struct param *param);

/* The row of this name, or of the deprecated one, or NULL. */
const struct param *params_find(const char *name);

/* The file that this bit of outputs stands for, e.g. "cloud.ply"; bit < PARAMS_OUTPUTS. */
const char *params_output_file(unsigned bit);

/* How many files a job with these parameters (resolved) writes, and the name of the i-th; false past the last. */
enum { PARAMS_FILE_BYTES = 48 };
unsigned params_file_count(const struct params *params);
bool params_file(const struct params *params, unsigned i, char name[PARAMS_FILE_BYTES]);

/* The name in the table (or in extra, a NULL-terminated list that may be NULL) nearest to a mistyped one by edit
 * distance, or NULL when nothing is near. */
const char *params_suggest(const char *name, const char *const *extra);

/* The same of other names than the table's. */
const char *params_suggest_of(const char *name, const char *const *names);

/* All defaults. */
void params_defaults(struct params *params);

/* Sets one parameter from text.  STATUS_BAD_PARAMETER with error->where = name and a text that says what is allowed
 * (and did-you-mean for an unknown name); params untouched on failure. */
enum status params_set(struct params *params, const char *name, const char *value, struct error *error) MUST_CHECK;

/* After all are set: conflicts (ratio with points; a parameter given differently by a deprecated name; fewer
 * neighbours_max than neighbours_min; a share of a bound that isn't given ...), and ratio = 0.1 where no goal was
 * given. error->where names the parameter. */
enum status params_resolve(struct params *params, struct error *error) MUST_CHECK;

/* Writes the value of one parameter as text, as params_set would read it back to the same value ("" = not given). */
void params_format(const struct params *params, const struct param *param, char *text, size_t text_bytes);

/* Fills text with what is allowed, e.g. "a number over 0, at most 1" or "one of subset, optimal"; PARAMS_ALLOWED_BYTES
 * hold it all. */
enum { PARAMS_ALLOWED_BYTES = 512 };
void params_allowed(const struct param *param, char *text, size_t text_bytes);

#endif
