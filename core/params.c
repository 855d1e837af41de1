/* The table of parameters, and what can be done with its rows.
 *
 * A row says where in struct params its value lives and how it is written; everything else (query, JSON, command line,
 * schema, help) is derived from it.  The defaults are text, read by the same code that reads a user's.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/params.h"

#include <assert.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "core/params_written.h"
#include "core/surface/reconstruct.h"
#include "core/text/number.h"

enum { VALUE_BYTES = 256, NUMBER_BYTES = 40, MAX_NAME = 64 };

static const char *const placements[] = {"subset", "optimal", "auto", NULL};
static const char *const dso_forms[] = {"rms", "sum", "none", NULL};
static const char *const area_weights[] = {"unit", "area", NULL};
#define NAME(constant, name, reported, what, source) #name,
#define HELP(constant, name, reported, what, source) "; " #name ": " what " (" source ")"
static const char *const reconstructions[] = {RECONSTRUCTION_ROWS(NAME) NULL};
static const char reconstructions_help[] = "How the surface is found through the kept points" RECONSTRUCTION_ROWS(HELP);
#undef NAME
#undef HELP
static const char *const surface_forms[] = {"closed", "open", "heightfield", "auto", "given", NULL};
static const char *const orders[] = {"auto", "simplify-first", "reconstruct-first", NULL};
static const char *const boundary_forms[] = {"fill", "keep", "auto", NULL};
static const char *const refine_forms[] = {"none", "flips", "full", NULL};
static const char *const reference_forms[] = {"auto", "points", "faces", "reconstruction", NULL};
static const char *const denoise_forms[] = {"none", "outliers", "full", "auto", "noisy", NULL};
static const char *const switch_forms[] = {"false", "true", NULL};
static const char *const attribute_forms[] = {"nearest", "mean", NULL};
static const char *const encodings[] = {"binary", "ascii", NULL};
static const char *const colour_bits[] = {"8", "16", "keep", NULL};
static const char *const pcd_precisions[] = {"float", "double", NULL};
static const char *const ups[] = {"auto", "x", "y", "z", NULL};
static const char *const xyz_headers[] = {"none", "plain", "hash", NULL};
/* The bits of outputs; then their second names: that of the file, or where the first is that one, a short one. */
static const char *const output_names[] = {"cloud",       "xyz",       "mesh",      "report",      "dso",
                                           "error",       "cloud.pcd", "mesh.obj",  "mesh.stl",    "mesh.glb",
                                           "preview.png", "cloud.las", "cloud.laz", "tileset",     "cloud.copc.laz",
                                           "cloud.ply",   "cloud.xyz", "mesh.ply",  "report.json", "dso.ply",
                                           "error.ply",   "pcd",       "obj",       "stl",         "glb",
                                           "preview",     "las",       "laz",       "tileset.3tz", "copc",
                                           NULL};

#define AT(member) offsetof(struct params, member)

static const struct param table[] = {
    {"ratio", PARAM_NUMBER, AT(ratio), 0, 1, true, "", NULL, "", true,
     "Keep floor(ratio x points) points; 0.1 where no goal is given"},
    {"points", PARAM_INTEGER, AT(points), 1, 4294967294.0, false, "", NULL, "points", true,
     "Keep exactly this many points, or all distinct ones where they are fewer"},
    {"max_deviation", PARAM_NUMBER, AT(max_deviation), 0, 1e300, true, "", NULL, "units of the file", true,
     "Keep as few points as a search finds with no input point farther than this from the result, as measured: from "
     "the mesh where one is made, else from the tangent plane at the nearest kept point; points that denoise drops "
     "aren't bounded, nor is how far the mesh is from all points where there are none; with ratio or points, "
     "whichever stops first; takes up to ten times as long"},
    {"max_deviation_rel", PARAM_NUMBER, AT(max_deviation_rel), 0, 1, true, "", NULL,
     "fraction of the bounding-box diagonal", true, "max_deviation as a fraction of the diagonal"},
    {"deviation_share", PARAM_NUMBER, AT(deviation_share), 0, 1, true, "1", NULL, "", true,
     "The share of the points that are to be within max_deviation: 0.999 lets one in a thousand be farther, so that a "
     "few places don't decide how many points are kept"},
    {"spacing", PARAM_NUMBER, AT(spacing), 0, 1e300, true, "", NULL, "units of the file", true,
     "Keep no two points nearer to each other than this; of points that are, the more important one stays. Alone it "
     "keeps all that have this distance, with another goal at most as many"},
    {"max_error", PARAM_NUMBER, AT(max_error), 0, 1, true, "", NULL, "fraction of the bounding-box diagonal", true,
     "Deprecated, use max_deviation: remove points as long as the quadric error, which no output shows, stays below "
     "this; with ratio or points, whichever stops first"},
    {"levels", PARAM_LEVELS, AT(levels), 0, 1, true, "", NULL, "", true,
     "Ratios, separated by commas: a cloud and a mesh of each, from one contraction, named cloud_RATIO.ply and "
     "mesh_RATIO.ply; cloud.ply and mesh.ply are of the largest ratio"},
    {"crop", PARAM_NUMBERS, AT(crop), PARAMS_BOX_NUMBERS, PARAMS_MAX_NUMBERS, false, "", NULL, "units of the file",
     true,
     "Before all else: only points within this box, x0,y0,z0,x1,y1,z1, or, where there are eight numbers and more, "
     "within this polygon, x,y,x,y,... (a triangle has its first corner twice)"},
    {"where", PARAM_CONDITIONS, AT(where), 0, 0, false, "", NULL, "", true,
     "Before all else: only points for which all these conditions hold, as class==2|6,intensity>100: a property of "
     "the input, ==, !=, <, <=, > or >=, and a number, or several with | between them; class, return and returns are "
     "known for classification, return_number and number_of_returns"},
    {"viewpoint", PARAM_NUMBERS, AT(viewpoint), PARAMS_PLACE_NUMBERS, PARAMS_PLACE_NUMBERS, false, "", NULL,
     "units of the file", true,
     "Where the input was scanned from, as x,y,z: normals and surfaces with borders face it; without it what the file "
     "says of that is taken"},
    {"normals", PARAM_CHOICE, AT(normals), 0, 0, false, "false", switch_forms, "", true,
     "true: clouds and meshes are written with a normal at each point, nx, ny, nz: the input's own where it has them "
     "and they fit its points, else computed, towards the side that the mesh has in front or, without one, all towards "
     "the outside or the viewpoint"},
    {"outputs", PARAM_FLAGS, AT(outputs), 0, PARAMS_OUTPUTS, false, "cloud,report", output_names, "", true,
     "What to write, separated by commas: the cloud as cloud.ply (cloud), cloud.xyz (xyz), cloud.pcd, cloud.las, "
     "cloud.laz; as a tree of points, 3D Tiles in tileset.3tz (tileset), COPC in cloud.copc.laz (copc); the mesh as "
     "mesh.ply (mesh), mesh.obj, mesh.stl, mesh.glb; "
     "report.json (report); dso.ply (dso) and "
     "error.ply (error), which "
     "show every original point with its discrete shape operator, its distance to the mesh; preview.png, a "
     "picture of before, after and deviation"},
    {"denoise", PARAM_CHOICE, AT(denoise), 0, 0, false, "noisy", denoise_forms, "", true,
     "Before all other steps: outliers drops points that belong to no surface; full also smooths the others along "
     "their normals and keeps edges: points are then written at their smoothed positions, with all else unchanged, and "
     "errors are measured from there; auto: outliers where they are many or scattered, full where noise is large "
     "against the distances between points, and nothing where neither is; noisy: for meshes alone, full "
     "where noise is so large that a surface of the points would be crumpled, as auto but for smoothing where it would "
     "have spikes of strays, and nothing of any other cloud; with max_deviation it moves none; all three drop what "
     "is in the file twice, as of scans that don't fit each other, unless deviations are bounded"},
    {"placement", PARAM_CHOICE, AT(placement), 0, 0, false, "auto", placements, "", true,
     "subset: mesh vertices are original points; optimal: mesh vertices move freely for the lowest error; auto: "
     "optimal "
     "where the surface is the input's own faces (surface=given) without texture coordinates and seams, else subset"},
    {"dso", PARAM_CHOICE, AT(dso), 0, 0, false, "rms", dso_forms, "", true,
     "Form of the discrete shape operator that weights the quadrics: rms (robust), sum (the paper's), none"},
    {"dso_exponent", PARAM_NUMBER, AT(dso_exponent), -2, 4, false, "0.25", NULL, "", true,
     "Exponent of the discrete shape operator in the weight; 1 is the paper's"},
    {"area_weight", PARAM_CHOICE, AT(area_weight), 0, 0, false, "area", area_weights, "", true,
     "Weight of a virtual triangle's plane: its area, or unit (the paper's)"},
    {"line_quadric", PARAM_NUMBER, AT(line_quadric), 0, 1, false, "0.003", NULL, "", true,
     "Weight of the line quadric along the normal, which keeps flat regions evenly sampled"},
    {"weights", PARAM_WEIGHTS, AT(weights), 0, 0, false, "", NULL, "", true,
     "Edges of attributes count as features, too, each with its weight, as rgb:0.2,intensity:0.1: a step by the whole "
     "range of an attribute of weight 1 counts as much as one by a tenth of the diagonal; rgb is red, green and blue"},
    {"neighbourhood", PARAM_NUMBER, AT(neighbourhood), 1, 16, false, "2.5", NULL, "nearest-neighbour distances", true,
     "Radius of the neighbourhood (Gopi's m) as a multiple of the distance to the nearest neighbour"},
    {"neighbours_min", PARAM_INTEGER, AT(neighbours_min), 3, 63, false, "6", NULL, "points", true,
     "Fewest neighbours of a point; three times as many where the cloud is noisy"},
    {"neighbours_max", PARAM_INTEGER, AT(neighbours_max), 3, 63, false, "10", NULL, "points", true,
     "Most neighbours of a point; three times as many where the cloud is noisy"},
    {"reconstruction", PARAM_CHOICE, AT(reconstruction), 0, 0, false, "tight", reconstructions, "", true,
     reconstructions_help},
    {"surface", PARAM_CHOICE, AT(surface), 0, 0, false, "auto", surface_forms, "", true,
     "What the points are of: closed: the skin of a solid, reconstructed as a closed mesh; open: sheets with borders, "
     "as scans of rooms and single views are; heightfield: one sheet seen from above, as terrain is; given: the "
     "input's own faces, whose edges are collapsed, with borders and seams of texture coordinates kept; auto: given "
     "where the input has faces, else found out from the points, and told in the report"},
    {"order", PARAM_CHOICE, AT(order), 0, 0, false, "auto", orders, "", true,
     "simplify-first: the surface is reconstructed from the kept points; reconstruct-first: from more, and its edges "
     "are collapsed with the topology that it has; auto: the latter where it has borders, where walls are thinner "
     "than kept points are apart, along creases, and where vertices move freely (placement=optimal), as the report "
     "says"},
    {"boundary", PARAM_CHOICE, AT(boundary), 0, 0, false, "auto", boundary_forms, "", true,
     "Borders of a surface that is reconstructed as closed (surface=closed, which this implies): fill: the mesh is "
     "closed; keep: facets that no point supports are dropped; auto: fill where the surface is found to be closed"},
    {"close_holes", PARAM_NUMBER, AT(close_holes), 0, 1e300, true, "", NULL, "units of the file", true,
     "Close the holes of a mesh with borders whose borders are at most this long; where the surface ends is no hole"},
    {"attributes", PARAM_CHOICE, AT(attributes), 0, 0, false, "nearest", attribute_forms, "", true,
     "Attributes of a mesh's vertices: nearest: of the vertex's own point, or where it was moved freely of the nearest "
     "point; mean: numbers with fractions, colours and intensity averaged over all points that the vertex is nearest "
     "to"},
    {"refine", PARAM_CHOICE, AT(refine), 0, 0, false, "full", refine_forms, "", true,
     "Refinement of the mesh against the original points: none, flips of edges, or full (vertices move too)"},
    {"reference", PARAM_CHOICE, AT(reference), 0, 0, false, "auto", reference_forms, "", true,
     "What the mesh is measured against: points, the input's own faces, or a reconstruction of the full cloud; "
     "auto takes the input's faces, and points where it has none, none with an area, or so many equally near ones that "
     "measuring would take too long; the report says which"},
    {"encoding", PARAM_CHOICE, AT(encoding), 0, 0, false, "binary", encodings, "", true, "Encoding of PLY outputs"},
    {"colours", PARAM_CHOICE, AT(colours), 0, 0, false, "8", colour_bits, "bits", true,
     "Bits of each component of red, green and blue in outputs: 8, which all programs show; 16; or keep, as the input "
     "has them"},
    {"pcd_precision", PARAM_CHOICE, AT(pcd_precision), 0, 0, false, "float", pcd_precisions, "", true,
     "Coordinates of cloud.pcd: float, 32 bits around an origin that the report tells where it isn't 0, or double, "
     "which PCL and most other programs can't read"},
    {"header", PARAM_CHOICE, AT(header), 0, 0, false, "none", xyz_headers, "", true,
     "First line of cloud.xyz: none, which all programs read; plain, the names of the columns; or hash, the same "
     "behind a #"},
    {"quantize", PARAM_CHOICE, AT(quantize), 0, 0, false, "false", switch_forms, "", true,
     "true: positions in mesh.glb and in tiles have 16 bits along each axis of their box, normals 8 "
     "(KHR_mesh_quantization)"},
    {"meshopt", PARAM_CHOICE, AT(meshopt), 0, 0, false, "false", switch_forms, "", true,
     "true: mesh.glb and tiles are compressed, for programs that read EXT_meshopt_compression"},
    {"columns", PARAM_COLUMNS, AT(columns), 0, 0, false, "", NULL, "", true,
     "What the columns of a text input are, where its first line doesn't say so: names of the first ones in their "
     "order, - for one to leave out (-,x,y,z,intensity), or pairs of a name and a column's name or number "
     "(x:east,y:north,z:4)"},
    {"properties", PARAM_NAMES, AT(properties), 0, 0, false, "", NULL, "", true,
     "Which properties of the points outputs have besides x, y and z, as rgb,intensity: all where it isn't given, or "
     "none; rgb is red, green, blue and alpha, normals nx, ny and nz; fields that LAS always has are 0 where they go"},
    {"preview_size", PARAM_INTEGER, AT(preview_size), 64, 1024, false, "480", NULL, "pixels", true,
     "Width of each of the three pictures in preview.png"},
    {"preview_azimuth", PARAM_NUMBER, AT(preview_azimuth), -360, 360, false, "", NULL, "degrees", true,
     "Where preview.png is looked at from: 0 is the front, 90 the right side; without it the widest side, 30 degrees "
     "from its right or left"},
    {"preview_elevation", PARAM_NUMBER, AT(preview_elevation), -90, 90, false, "25", NULL, "degrees", true,
     "How far from above preview.png is looked at: 0 is level, 90 straight down"},
    {"up", PARAM_CHOICE, AT(up), 0, 0, false, "auto", ups, "", true,
     "Which axis of the input points upwards, in preview.png and in mesh.glb, whose node turns it to glTF's y without "
     "changing the coordinates; auto: y of glTF, z of what is flat, else y or z, whichever the points stand on"},
    {"seed", PARAM_INTEGER, AT(seed), 0, 4294967295.0, false, "0", NULL, "", true,
     "Seed of the samples that the error is measured with"},
    {"threads", PARAM_INTEGER, AT(threads), 0, 256, false, "0", NULL, "", false,
     "Threads to use; 0 takes all processors; results don't depend on it"},
};
enum { ROWS = sizeof table / sizeof table[0] };

/* Deprecated names.  Values of at most PARAMS_ALIAS_BYTES - 1 letters, never "". */
static const struct param_alias aliases[PARAMS_ALIASES] = {
    {"cocone", "reconstruction"},
    {"preview_up", "up"},
};

static const char *const everyday[] = {"ratio",   "points",    "max_deviation", "spacing", "levels",
                                       "crop",    "where",     "outputs",       "normals", "denoise",
                                       "surface", "viewpoint", "columns",       "threads", NULL};

const struct param *params_table(size_t *count) {
    *count = ROWS;
    return table;
}

const struct param_alias *params_aliases(size_t *count) {
    *count = PARAMS_ALIASES;
    return aliases;
}

bool params_is_deprecated(const struct param *param) { return strcmp(param->name, "max_error") == 0; }

bool params_is_everyday(const struct param *param) {
    for (const char *const *name = everyday; *name; name++)
        if (strcmp(param->name, *name) == 0) return true;
    return false;
}

const struct param *params_find(const char *name) {
    for (size_t i = 0; i < PARAMS_ALIASES; i++)
        if (strcmp(aliases[i].name, name) == 0) name = aliases[i].of;
    for (size_t i = 0; i < ROWS; i++)
        if (strcmp(table[i].name, name) == 0) return &table[i];
    return NULL;
}

/* ------------------------------------------------------------------------------------------------ did you mean */

static size_t min3(size_t a, size_t b, size_t c) {
    size_t m = a < b ? a : b;
    return m < c ? m : c;
}

/* Letters in either case are the same, and so are - and _. */
static bool same_letter(char a, char b) {
    if (a == '-') a = '_';
    if (b == '-') b = '_';
    return strncasecmp(&a, &b, 1) == 0;
}

/* Damerau's: how many letters are missing, too many, wrong, or in the place of their neighbour.  Names longer than
 * MAX_NAME are far from everything. */
static size_t edit_distance(const char *a, const char *b) {
    size_t la = strlen(a), lb = strlen(b), d[3][MAX_NAME + 1]; /* this row and the two before it */
    if (la > MAX_NAME || lb > MAX_NAME) return SIZE_MAX;
    for (size_t j = 0; j <= lb; j++) d[0][j] = j;
    for (size_t i = 1; i <= la; i++) {
        size_t *row = d[i % 3], *above = d[(i + 2) % 3], *second = d[(i + 1) % 3];
        row[0] = i;
        for (size_t j = 1; j <= lb; j++) {
            row[j] = min3(above[j - 1] + !same_letter(a[i - 1], b[j - 1]), above[j] + 1, row[j - 1] + 1);
            bool swapped = i > 1 && j > 1 && same_letter(a[i - 1], b[j - 2]) && same_letter(a[i - 2], b[j - 1]);
            if (swapped && second[j - 2] + 1 < row[j]) row[j] = second[j - 2] + 1;
        }
    }
    return d[la % 3][lb];
}

/* One mistyping in four letters: short names have many neighbours. */
static bool is_near(size_t distance, const char *a, const char *b) {
    size_t la = strlen(a), lb = strlen(b), shorter = la < lb ? la : lb;
    return distance <= 3 && 4 * distance <= shorter + 1;
}

static void consider(const char *name, const char *candidate, const char **best, size_t *best_distance) {
    size_t distance = edit_distance(name, candidate);
    if (distance < *best_distance && is_near(distance, name, candidate)) *best = candidate, *best_distance = distance;
}

const char *params_output_file(unsigned bit) {
    assert(bit < PARAMS_OUTPUTS);
    return strchr(output_names[bit], '.') ? output_names[bit] : output_names[PARAMS_OUTPUTS + bit];
}

static const char *nearest(const char *name, bool of_table, const char *const *extra) {
    const char *best = NULL;
    size_t distance = SIZE_MAX;
    for (size_t i = 0; of_table && i < ROWS; i++) consider(name, table[i].name, &best, &distance);
    for (; extra && *extra; extra++) consider(name, *extra, &best, &distance);
    return best;
}

const char *params_suggest(const char *name, const char *const *extra) { return nearest(name, true, extra); }

const char *params_suggest_of(const char *name, const char *const *names) { return nearest(name, false, names); }

/* ------------------------------------------------------------------------------------------------ values as text */

static void join_choices(const char *const *choices, size_t most, char *text, size_t text_bytes) {
    size_t used = 0;
    text[0] = 0;
    for (size_t i = 0; i < most && choices[i] && used < text_bytes; i++)
        used += (size_t)snprintf(text + used, text_bytes - used, "%s%s", i ? ", " : "", choices[i]);
}

void params_allowed(const struct param *param, char *text, size_t text_bytes) {
    char list[PARAMS_ALLOWED_BYTES];
    /* Second names would be too many to read. */
    size_t most = param->type == PARAM_FLAGS ? (size_t)param->max : SIZE_MAX;
    if (param->choices) join_choices(param->choices, most, list, sizeof list);
    switch (param->type) {
    case PARAM_NUMBER:
        snprintf(text, text_bytes, "a number %s %g, at most %g", param->exclusive_min ? "over" : "from", param->min,
                 param->max);
        break;
    case PARAM_INTEGER: snprintf(text, text_bytes, "a whole number from %.0f to %.0f", param->min, param->max); break;
    case PARAM_CHOICE: snprintf(text, text_bytes, "one of %s", list); break;
    case PARAM_FLAGS: snprintf(text, text_bytes, "one or more of %s, separated by commas", list); break;
    case PARAM_LEVELS:
        snprintf(text, text_bytes, "up to %d different numbers over 0, at most 1, separated by commas",
                 PARAMS_MAX_LEVELS);
        break;
    case PARAM_COLUMNS:
        snprintf(text, text_bytes,
                 "different names with x, y and z among them, separated by commas, each behind its place or followed "
                 "by : and a column; at most %d bytes",
                 COLUMN_LIST_BYTES - 1);
        break;
    case PARAM_NUMBERS:
        if (param->min == param->max)
            snprintf(text, text_bytes, "%.0f numbers, separated by commas", param->min);
        else
            snprintf(text, text_bytes, "%.0f numbers, separated by commas, or an even number of them from %.0f to %.0f",
                     param->min, param->min + 2, param->max);
        break;
    case PARAM_CONDITIONS:
        snprintf(text, text_bytes,
                 "conditions like intensity>100, class==2 or class==2|6, separated by commas; at most %d bytes",
                 CONDITION_LIST_BYTES - 1);
        break;
    case PARAM_WEIGHTS:
        snprintf(text, text_bytes,
                 "properties and numbers over 0, at most 100, as rgb:0.2,intensity:0.1, none twice; at most %d bytes",
                 WEIGHT_LIST_BYTES - 1);
        break;
    case PARAM_NAMES:
        snprintf(text, text_bytes, "none, or names of properties, separated by commas, none twice; at most %d bytes",
                 NAME_LIST_BYTES - 1);
        break;
    }
}

static int choice_index(const char *const *choices, const char *text, size_t length) {
    for (int i = 0; choices[i]; i++)
        if (strlen(choices[i]) == length && strncmp(choices[i], text, length) == 0) return i;
    return -1;
}

static bool in_range(const struct param *param, double value) {
    return isfinite(value) && value <= param->max && (param->exclusive_min ? value > param->min : value >= param->min);
}

/* Digits, sign, point and exponent alone: no hexadecimal numbers, no "inf", no leading space. */
static bool is_plain_number(const char *text) { return text[0] && text[strspn(text, "+-.0123456789eE")] == 0; }

static bool set_number(void *member, const struct param *param, const char *text) {
    char *end;
    if (!is_plain_number(text)) return false;
    double value = number_read(text, &end);
    if (end == text || *end || !in_range(param, value)) return false;
    *(double *)member = value;
    return true;
}

static bool set_integer(void *member, const struct param *param, const char *text) {
    char *end;
    if (!text[0] || text[strspn(text, "0123456789")]) return false;
    errno = 0;
    unsigned long long value = strtoull(text, &end, 10);
    if (errno || *end || !in_range(param, (double)value)) return false;
    *(uint64_t *)member = value;
    return true;
}

static bool set_choice(void *member, const struct param *param, const char *text) {
    int index = choice_index(param->choices, text, strlen(text));
    if (index < 0) return false;
    *(int *)member = index;
    return true;
}

static bool set_flags(void *member, const struct param *param, const char *text) {
    uint32_t bits = 0;
    for (const char *item = text;;) {
        size_t length = strcspn(item, ",");
        int index = choice_index(param->choices, item, length);
        if (index < 0) return false;
        bits |= 1u << (unsigned)index % (unsigned)param->max;
        if (!item[length]) break;
        item += length + 1;
    }
    *(uint32_t *)member = bits;
    return true;
}

/* Whether two ratios might be the same in the names of files, which have ten digits of them. */
static bool same_level(double a, double b) { return fabs(a - b) <= 1e-9 * a; }

/* Puts a ratio into its place; false when it is there already or there is no room. */
static bool insert_level(struct param_levels *levels, double ratio) {
    uint32_t i = levels->count;
    if (i == PARAMS_MAX_LEVELS) return false;
    for (uint32_t k = 0; k < i; k++)
        if (same_level(levels->ratio[k], ratio)) return false;
    for (; i > 0 && levels->ratio[i - 1] < ratio; i--) levels->ratio[i] = levels->ratio[i - 1];
    levels->ratio[i] = ratio;
    levels->count++;
    return true;
}

static bool set_levels(void *member, const struct param *param, const char *text) {
    struct param_levels levels = {0};
    for (const char *item = text;;) {
        char number[NUMBER_BYTES];
        size_t length = strcspn(item, ",");
        double ratio;
        if (length >= sizeof number) return false;
        snprintf(number, sizeof number, "%.*s", (int)length, item);
        if (!set_number(&ratio, param, number) || !insert_level(&levels, ratio)) return false;
        if (!item[length]) break;
        item += length + 1;
    }
    *(struct param_levels *)member = levels;
    return true;
}

static bool set_columns(void *member, const struct param *param, const char *text) {
    (void)param;
    if (!column_list_is_valid(text)) return false;
    memset(member, 0, COLUMN_LIST_BYTES);
    memcpy(member, text, strlen(text));
    return true;
}

static bool set_conditions(void *member, const struct param *param, const char *text) {
    (void)param;
    if (!condition_list_is_valid(text)) return false;
    memset(member, 0, CONDITION_LIST_BYTES);
    memcpy(member, text, strlen(text));
    return true;
}

static bool set_weights(void *member, const struct param *param, const char *text) {
    (void)param;
    if (!weight_list_is_valid(text)) return false;
    memset(member, 0, WEIGHT_LIST_BYTES);
    memcpy(member, text, strlen(text));
    return true;
}

static bool set_names(void *member, const struct param *param, const char *text) {
    (void)param;
    if (!name_list_is_valid(text)) return false;
    memset(member, 0, NAME_LIST_BYTES);
    memcpy(member, text, strlen(text));
    return true;
}

static bool set_numbers(void *member, const struct param *param, const char *text) {
    struct param_numbers numbers = {0};
    struct param any = *param;
    any.min = -1e300, any.max = 1e300;
    for (const char *item = text;;) {
        char number[NUMBER_BYTES];
        size_t length = strcspn(item, ",");
        if (length >= sizeof number || numbers.count == PARAMS_MAX_NUMBERS) return false;
        snprintf(number, sizeof number, "%.*s", (int)length, item);
        if (!set_number(&numbers.value[numbers.count++], &any, number)) return false;
        if (!item[length]) break;
        item += length + 1;
    }
    bool odd = param->min != param->max && numbers.count % 2;
    if (numbers.count < param->min || numbers.count > param->max || odd) return false;
    *(struct param_numbers *)member = numbers;
    return true;
}

static bool set_value(struct params *params, const struct param *param, const char *value) {
    static bool (*const setters[])(void *, const struct param *, const char *) = {
        [PARAM_NUMBER] = set_number,   [PARAM_INTEGER] = set_integer,       [PARAM_CHOICE] = set_choice,
        [PARAM_FLAGS] = set_flags,     [PARAM_LEVELS] = set_levels,         [PARAM_COLUMNS] = set_columns,
        [PARAM_NUMBERS] = set_numbers, [PARAM_CONDITIONS] = set_conditions, [PARAM_WEIGHTS] = set_weights,
        [PARAM_NAMES] = set_names};
    return setters[param->type]((char *)params + param->offset, param, value);
}

/* Sets a value by its deprecated name: it holds unless the present name is given, too. */
static bool set_by_alias(struct params *params, struct param_alias_use *use, const struct param *param,
                         const char *value) {
    struct params found = *params;
    if (!set_value(&found, param, value)) return false;
    params_format(&found, param, use->value, sizeof use->value);
    return use->by_name || set_value(params, param, value);
}

static bool set_by_name(struct params *params, const char *name, const struct param *param, const char *value) {
    for (size_t i = 0; i < PARAMS_ALIASES; i++)
        if (strcmp(name, aliases[i].name) == 0) return set_by_alias(params, &params->alias[i], param, value);
    if (!set_value(params, param, value)) return false;
    for (size_t i = 0; i < PARAMS_ALIASES; i++) params->alias[i].by_name |= strcmp(name, aliases[i].of) == 0;
    return true;
}

static void clear_value(struct params *params, const struct param *param) {
    void *member = (char *)params + param->offset;
    if (param->type == PARAM_NUMBER) *(double *)member = NAN;
    if (param->type == PARAM_INTEGER) *(uint64_t *)member = 0;
    if (param->type == PARAM_LEVELS) *(struct param_levels *)member = (struct param_levels){0};
    if (param->type == PARAM_COLUMNS) memset(member, 0, COLUMN_LIST_BYTES);
    if (param->type == PARAM_NUMBERS) *(struct param_numbers *)member = (struct param_numbers){0};
    if (param->type == PARAM_CONDITIONS) memset(member, 0, CONDITION_LIST_BYTES);
    if (param->type == PARAM_WEIGHTS) memset(member, 0, WEIGHT_LIST_BYTES);
    if (param->type == PARAM_NAMES) memset(member, 0, NAME_LIST_BYTES);
}

void params_defaults(struct params *params) {
    memset(params, 0, sizeof *params);
    for (size_t i = 0; i < ROWS; i++) {
        if (!table[i].default_text[0]) {
            clear_value(params, &table[i]);
            continue;
        }
        bool ok = set_value(params, &table[i], table[i].default_text);
        assert(ok);
        (void)ok;
    }
}

enum status params_set(struct params *params, const char *name, const char *value, struct error *error) {
    const struct param *param = params_find(name);
    if (!param) {
        const char *near = params_suggest(name, NULL);
        return error_set(error, STATUS_BAD_PARAMETER, name, "unknown parameter%s%s%s", near ? "; did you mean '" : "",
                         near ? near : "", near ? "'?" : "");
    }
    char text[PARAMS_WRITTEN_BYTES];
    const char *written = params_written(param, value, text);
    if (set_by_name(params, name, param, written)) return STATUS_OK;
    if (written != value && set_by_name(params, name, param, value)) return STATUS_OK;
    char allowed[PARAMS_ALLOWED_BYTES];
    params_allowed(param, allowed, sizeof allowed);
    return error_set(error, STATUS_BAD_PARAMETER, name, "'%.40s' is not allowed; it takes %s", value, allowed);
}

/* Of which there is one for each of the levels, too. */
static const uint32_t of_levels = OUTPUT_ANY_CLOUD | OUTPUT_ANY_MESH;

unsigned params_file_count(const struct params *params) {
    return (unsigned)__builtin_popcount(params->outputs) +
           params->levels.count * (unsigned)__builtin_popcount(params->outputs & of_levels);
}

bool params_file(const struct params *params, unsigned i, char name[PARAMS_FILE_BYTES]) {
    for (unsigned bit = 0; bit < PARAMS_OUTPUTS; bit++) {
        if (!(params->outputs & 1u << bit)) continue;
        const char *file = params_output_file(bit);
        unsigned levels = of_levels & 1u << bit ? params->levels.count : 0;
        int stem = (int)strcspn(file, ".");
        if (i < levels)
            snprintf(name, PARAMS_FILE_BYTES, "%.*s_%.10g%s", stem, file, params->levels.ratio[i], file + stem);
        else if (i == levels)
            snprintf(name, PARAMS_FILE_BYTES, "%s", file);
        if (i <= levels) return true;
        i -= levels + 1;
    }
    return false;
}

/* The first deprecated name whose value differs from what the present name was given, or NULL. */
static const struct param_alias *find_alias_conflict(const struct params *params) {
    char value[PARAMS_ALIAS_BYTES];
    for (size_t i = 0; i < PARAMS_ALIASES; i++) {
        if (!params->alias[i].value[0]) continue;
        params_format(params, params_find(aliases[i].of), value, sizeof value);
        if (strcmp(value, params->alias[i].value) != 0) return &aliases[i];
    }
    return NULL;
}

enum status params_resolve(struct params *params, struct error *error) {
    const struct param_alias *alias = find_alias_conflict(params);
    if (alias)
        return error_set(error, STATUS_BAD_PARAMETER, alias->name,
                         "is a deprecated name of %s and conflicts with it; give one of them", alias->of);
    bool has_ratio = !isnan(params->ratio), has_points = params->points != 0;
    if (has_ratio && has_points)
        return error_set(error, STATUS_BAD_PARAMETER, "points", "conflicts with ratio; give one of them");
    bool bounded = params_bound_deviation(params);
    if (params->levels.count && (has_ratio || has_points || bounded || !isnan(params->max_error)))
        return error_set(error, STATUS_BAD_PARAMETER, "levels",
                         "conflicts with ratio, points, max_deviation, max_deviation_rel and max_error");
    if (!isnan(params->max_deviation) && !isnan(params->max_deviation_rel))
        return error_set(error, STATUS_BAD_PARAMETER, "max_deviation_rel",
                         "conflicts with max_deviation; give one of them");
    if (params->deviation_share < 1 && !bounded)
        return error_set(error, STATUS_BAD_PARAMETER, "deviation_share", "is of max_deviation, which isn't given");
    bool has_borders = params->surface == SURFACE_OPEN || params->surface == SURFACE_HEIGHTFIELD;
    if (params->boundary == BOUNDARY_FILL && has_borders)
        return error_set(error, STATUS_BAD_PARAMETER, "boundary",
                         "fill makes a closed mesh, and conflicts with surface=open and surface=heightfield");
    if (params->neighbours_min > params->neighbours_max)
        return error_set(error, STATUS_BAD_PARAMETER, "neighbours_max", "is below neighbours_min (%llu)",
                         (unsigned long long)params->neighbours_min);
    if (params_file_count(params) > PARAMS_MAX_FILES)
        return error_set(error, STATUS_BAD_PARAMETER, "outputs", "%u files with all levels, at most %d are written",
                         params_file_count(params), PARAMS_MAX_FILES);
    bool has_goal = has_ratio || has_points || bounded || !isnan(params->max_error) || !isnan(params->spacing);
    if (!has_goal && !params->levels.count) params->ratio = 0.1;
    if (params->surface == SURFACE_AUTO && params->boundary != BOUNDARY_AUTO) params->surface = SURFACE_CLOSED;
    memset(params->alias, 0, sizeof params->alias);
    return STATUS_OK;
}

static void format_flags(uint32_t bits, const struct param *param, char *text, size_t text_bytes) {
    size_t used = 0;
    text[0] = 0;
    for (unsigned i = 0; i < (unsigned)param->max && used < text_bytes; i++)
        if (bits & 1u << i)
            used += (size_t)snprintf(text + used, text_bytes - used, "%s%s", used ? "," : "", param->choices[i]);
}

/* The fewest digits that read back as the same number. */
static void format_number(double value, char *text, size_t text_bytes) {
    char number[NUMBER_TEXT_BYTES] = "";
    if (isnan(value)) {
        text[0] = 0;
        return;
    }
    for (int digits = 6; digits <= 17; digits++) {
        number_print(number, digits, value);
        if (number_read(number, NULL) == value) break;
    }
    snprintf(text, text_bytes, "%s", number);
}

static void format_list(const double *value, uint32_t count, char *text, size_t text_bytes) {
    size_t used = 0;
    text[0] = 0;
    for (uint32_t i = 0; i < count && used < text_bytes; i++) {
        char number[NUMBER_BYTES];
        format_number(value[i], number, sizeof number);
        used += (size_t)snprintf(text + used, text_bytes - used, "%s%s", i ? "," : "", number);
    }
}

void params_format(const struct params *params, const struct param *param, char *text, size_t text_bytes) {
    const void *member = (const char *)params + param->offset;
    switch (param->type) {
    case PARAM_NUMBER: format_number(*(const double *)member, text, text_bytes); break;
    case PARAM_INTEGER: {
        uint64_t value = *(const uint64_t *)member;
        bool given = value != 0 || param->default_text[0];
        snprintf(text, text_bytes, "%llu", (unsigned long long)value);
        if (!given) text[0] = '\0';
        break;
    }
    case PARAM_CHOICE: snprintf(text, text_bytes, "%s", param->choices[*(const int *)member]); break;
    case PARAM_FLAGS: format_flags(*(const uint32_t *)member, param, text, text_bytes); break;
    case PARAM_LEVELS: {
        const struct param_levels *levels = member;
        format_list(levels->ratio, levels->count, text, text_bytes);
        break;
    }
    case PARAM_NUMBERS: {
        const struct param_numbers *numbers = member;
        format_list(numbers->value, numbers->count, text, text_bytes);
        break;
    }
    case PARAM_CONDITIONS:
    case PARAM_WEIGHTS:
    case PARAM_NAMES:
    case PARAM_COLUMNS: snprintf(text, text_bytes, "%s", (const char *)member); break;
    }
}
