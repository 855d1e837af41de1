/* What whittle writes: a table of files, one row for each bit of the parameter `outputs`.
 *
 * The report comes last, because it lists what the others could not hold.  Files get their names together, at the end,
 * or whenever there are many of them.
 *
 * The input is never replaced: it is known by device and inode, so by no other name or link either.  Other files are
 * replaced where the user said where to write (-o) or that they may be (--force).  Both are asked of every planned file
 * before the work begins, and hold again when files get their names (core/io/out/file_out.h).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/output.h"

#include <errno.h>
#include <inttypes.h>
#include <libgen.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "api/codecs/report_json.h"
#include "core/base/alloc.h"
#include "core/cloud/colour_map.h"
#include "core/io/formats/las_fields.h"
#include "core/io/out/file_out.h"
#include "core/io/out/glb_write.h"
#include "core/io/out/las_write.h"
#include "core/io/out/mesh_attributes.h"
#include "core/io/out/obj_write.h"
#include "core/io/out/pcd_write.h"
#include "core/io/out/ply_write.h"
#include "core/io/out/stl_write.h"
#include "core/io/out/write.h"
#include "core/picture/png_write.h"
#include "core/pipeline/attributes.h"
#include "core/tileset/copc.h"
#include "core/tileset/tileset.h"
#include "server/cli/preview.h"

enum { MOST_OPEN = 16 };

struct outputs {
    const struct command_options *options;
    const struct cloud *cloud;
    const struct kept_file *kept; /* NULL: the points are the cloud's */
    const struct pipeline_result *result;
    const struct pipeline_level *level; /* the one to write */
    struct left_out *left_out;          /* of the report */
    /* Of each level's mesh: a point for each vertex with what it has of attributes, where that isn't what its point
     * has, else empty; and the numbers 0, 1 ... of vertices. */
    struct cloud vertices[PARAMS_MAX_LEVELS];
    uint32_t *number;
    struct file_out_rule rule;       /* what files may take the place of */
    struct file_out file[MOST_OPEN]; /* written, without their names yet */
    size_t files;
};

static enum status write_cloud(int fd, const struct outputs *o, struct error *error) {
    return cloud_write_ply(fd, o->cloud, o->result->kept, o->level->kept_count,
                           (enum encoding)o->options->params.encoding, error);
}

static enum status write_xyz(int fd, const struct outputs *o, struct error *error) {
    for (size_t j = 0; j < o->cloud->property_count; j++)
        if (o->cloud->property[j].is_list)
            left_out_add(o->left_out, "cloud.xyz", "%s: lines of text have no lists", o->cloud->property[j].name);
    enum xyz_header header = (enum xyz_header)o->options->params.header;
    if (header == HEADER_NONE && o->cloud->property_count > 3)
        left_out_add(o->left_out, "cloud.xyz", "names of the columns; header=plain or header=hash write them");
    return cloud_write_xyz(fd, o->cloud, o->result->kept, o->level->kept_count, header, error);
}

static enum status write_pcd(int fd, const struct outputs *o, struct error *error) {
    return cloud_write_pcd(fd, o->cloud, o->result->kept, o->level->kept_count,
                           (enum pcd_precision)o->options->params.pcd_precision, o->left_out, error);
}

static enum status write_las_or_laz(int fd, const struct outputs *o, bool compressed, struct error *error) {
    return cloud_write_las(fd, o->cloud, o->result->kept, o->level->kept_count, compressed,
                           (unsigned)o->options->params.threads, o->left_out, error);
}

static enum status write_las(int fd, const struct outputs *o, struct error *error) {
    return write_las_or_laz(fd, o, false, error);
}

static enum status write_laz(int fd, const struct outputs *o, struct error *error) {
    return write_las_or_laz(fd, o, true, error);
}

static enum status write_copc(int fd, const struct outputs *o, struct error *error) {
    return copc_write(fd, o->cloud, o->result->kept, o->level->kept_count, (unsigned)o->options->params.threads,
                      o->left_out, error);
}

static struct glb_packing packing_of(const struct outputs *o) {
    const struct params *params = &o->options->params;
    return (struct glb_packing){params->quantize == SWITCH_TRUE, params->meshopt == SWITCH_TRUE};
}

static enum status write_tileset(int fd, const struct outputs *o, struct error *error) {
    const struct tileset_points points = {.cloud = o->cloud,
                                          .kept = o->result->kept,
                                          .n = o->level->kept_count,
                                          .file = o->kept,
                                          .threads = (unsigned)o->options->params.threads,
                                          .packing = packing_of(o)};
    if (!points.kept && !points.file)
        return error_set(error, STATUS_BAD_PARAMETER, "output",
                         "tiles show the most important points first; use whittle without convert to rank them, with "
                         "--ratio 1 to keep all");
    if (o->options->tileset_folder)
        return tileset_write_folder(fd, o->options->tileset_folder, &points, o->left_out, error);
    return tileset_write_archive(fd, &points, o->left_out, error);
}

static bool is_scalar(const struct mesh_attributes *attributes, const struct property *property) {
    (void)attributes;
    return !property->is_list;
}

/* The level's mesh, with sources in the cloud that has its vertices' attributes.  Borrowed. */
static struct mesh mesh_of(const struct outputs *o, const struct cloud **cloud) {
    struct mesh mesh = o->level->mesh;
    const struct cloud *own = &o->vertices[o->level - o->result->level];
    *cloud = own->count ? own : o->cloud;
    if (own->count) mesh.source = o->number;
    return mesh;
}

static enum status write_mesh(int fd, const struct outputs *o, struct error *error) {
    struct mesh_attributes attributes;
    const struct cloud *cloud;
    const struct mesh mesh = mesh_of(o, &cloud);
    mesh_attributes_find(&mesh, cloud, &attributes);
    mesh_attributes_note(&attributes, cloud, "mesh.ply", is_scalar, true, o->left_out);
    return mesh_write_ply(fd, &mesh, cloud, (enum encoding)o->options->params.encoding, error);
}

static enum status write_obj(int fd, const struct outputs *o, struct error *error) {
    const struct cloud *cloud;
    const struct mesh mesh = mesh_of(o, &cloud);
    return mesh_write_obj(fd, &mesh, cloud, o->left_out, error);
}

static enum status write_stl(int fd, const struct outputs *o, struct error *error) {
    const struct cloud *cloud;
    const struct mesh mesh = mesh_of(o, &cloud);
    return mesh_write_stl(fd, &mesh, cloud, o->left_out, error);
}

static enum status write_glb(int fd, const struct outputs *o, struct error *error) {
    const struct cloud *cloud;
    const struct mesh mesh = mesh_of(o, &cloud);
    const struct glb_packing packing = packing_of(o);
    return mesh_write_glb(fd, &mesh, cloud, &packing, (enum up)preview_up(&o->options->params, o->cloud), o->left_out,
                          error);
}

static enum status write_report(int fd, const struct outputs *o, struct error *error) {
    return report_json_write(fd, &o->result->report, &o->options->params, error);
}

static enum status write_painted(int fd, const struct outputs *o, const char *name, const float *value,
                                 struct error *error) {
    struct cloud painted = {0};
    if (paint_cloud(o->cloud, name, value, &painted))
        return error_set(error, STATUS_NO_MEMORY, name, "no memory for the painted cloud");
    enum status status =
        cloud_write_ply(fd, &painted, NULL, painted.count, (enum encoding)o->options->params.encoding, error);
    cloud_done(&painted);
    return status;
}

static enum status write_dso(int fd, const struct outputs *o, struct error *error) {
    return write_painted(fd, o, "dso", o->result->dso, error);
}

static enum status write_error(int fd, const struct outputs *o, struct error *error) {
    return write_painted(fd, o, "distance", o->result->distance, error);
}

static enum status write_preview(int fd, const struct outputs *o, struct error *error) {
    struct picture picture = {0};
    enum status status = preview_make(&o->options->params, o->cloud, o->result, &picture, error);
    if (!status) status = picture_write_png(fd, &picture, error);
    picture_done(&picture);
    return status;
}

struct file {
    uint32_t bit;            /* of params.outputs */
    const char *stem, *type; /* of the name */
    bool each_level;         /* one for each of the levels too, named stem_RATIO.type */
    enum status (*write)(int fd, const struct outputs *outputs, struct error *error);
};

static const struct file files[] = {
    {OUTPUT_CLOUD, "cloud", "ply", true, write_cloud},       {OUTPUT_CLOUD_XYZ, "cloud", "xyz", true, write_xyz},
    {OUTPUT_CLOUD_PCD, "cloud", "pcd", true, write_pcd},     {OUTPUT_MESH, "mesh", "ply", true, write_mesh},
    {OUTPUT_MESH_OBJ, "mesh", "obj", true, write_obj},       {OUTPUT_MESH_STL, "mesh", "stl", true, write_stl},
    {OUTPUT_MESH_GLB, "mesh", "glb", true, write_glb},       {OUTPUT_DSO, "dso", "ply", false, write_dso},
    {OUTPUT_ERROR, "error", "ply", false, write_error},      {OUTPUT_PREVIEW, "preview", "png", false, write_preview},
    {OUTPUT_CLOUD_LAS, "cloud", "las", true, write_las},     {OUTPUT_CLOUD_LAZ, "cloud", "laz", true, write_laz},
    {OUTPUT_TILESET, "tileset", "3tz", true, write_tileset}, {OUTPUT_CLOUD_COPC, "cloud", "copc.laz", true, write_copc},
    {OUTPUT_REPORT, "report", "json", false, write_report},
};
enum { FILES = sizeof files / sizeof files[0] };

/* ------------------------------------------------------------------------------------------------ the plan */

/* A file that will be written: a row, and the level that it is of. */
struct planned {
    const struct file *file;
    size_t level;
    bool named; /* by the level's ratio */
};

struct plan {
    size_t count;
    struct planned item[PARAMS_MAX_FILES]; /* params_resolve sees to it that there are no more */
};

static void plan_add(struct plan *plan, const struct file *file, size_t level, bool named) {
    if (plan->count < PARAMS_MAX_FILES) plan->item[plan->count++] = (struct planned){file, level, named};
}

static void make_plan(const struct params *params, struct plan *plan) {
    plan->count = 0;
    for (size_t i = 0; i < FILES; i++) {
        if (!(params->outputs & files[i].bit)) continue;
        for (uint32_t level = 0; files[i].each_level && level < params->levels.count; level++)
            plan_add(plan, &files[i], level, true);
        plan_add(plan, &files[i], 0, false);
    }
}

/* false where the name is too long. */
static bool name_file(const struct command_options *options, const struct planned *item, char path[PATH_MAX]) {
    const char *folder = options->output;
    char suffix[40] = "";
    size_t length = strlen(folder);
    int n;
    const char *type = item->file->type;
    if (options->tileset_folder && item->file->bit == OUTPUT_TILESET) type = "json";
    if (item->named) snprintf(suffix, sizeof suffix, "_%.10g", options->params.levels.ratio[item->level]);
    while (length > 1 && folder[length - 1] == '/') length--;
    if (options->to_file)
        n = snprintf(path, PATH_MAX, "%s", folder);
    else if (strcmp(folder, ".") == 0)
        n = snprintf(path, PATH_MAX, "%s%s.%s", item->file->stem, suffix, type);
    else
        n = snprintf(path, PATH_MAX, "%.*s/%s%s.%s", (int)length, folder, item->file->stem, suffix, type);
    return n > 0 && n < PATH_MAX;
}

static enum status refuse_name(const struct command_options *options, struct error *error) {
    return error_set(error, STATUS_IO, "output", "the name is too long: %.80s...", options->output);
}

/* ------------------------------------------------------------------------------------------------ one file */

/* The end of the name after its last dot, in the last part of the path, or after the one before that where a row is
 * called so; "" where there is none. */
static const char *extension(const char *path) {
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path, *dot = strrchr(name, '.');
    for (size_t i = 0; i < FILES; i++) {
        size_t length = strlen(files[i].type), whole = strlen(name);
        const char *end = name + whole - length;
        if (whole > length + 1 && end[-1] == '.' && strchr(files[i].type, '.') && strcasecmp(end, files[i].type) == 0)
            return end;
    }
    return dot && dot > name ? dot + 1 : "";
}

static bool is_kind(const struct file *a, const struct file *b) { return strcmp(a->stem, b->stem) == 0; }

/* The row that writes this format: the first of all, or of the kind that was asked for alone. */
static const struct file *find_file(const char *type, const struct file *asked) {
    for (size_t i = 0; i < FILES; i++)
        if (strcasecmp(files[i].type, type) == 0 && (!asked || is_kind(&files[i], asked))) return &files[i];
    return NULL;
}

/* The first row of a kind is its general name: `mesh` is any format of it, `mesh.obj` that one. */
static bool is_general(const struct file *file) {
    for (const struct file *f = files; f < file; f++)
        if (is_kind(f, file)) return false;
    return true;
}

static const struct file *file_of_bit(uint32_t bit) {
    for (size_t i = 0; i < FILES; i++)
        if (files[i].bit == bit) return &files[i];
    return NULL;
}

static void join_types(char *text, size_t bytes) {
    size_t used = 0;
    text[0] = 0;
    for (size_t i = 0; i < FILES && used < bytes; i++)
        if (find_file(files[i].type, NULL) == &files[i])
            used += (size_t)snprintf(text + used, bytes - used, "%s.%s", i ? ", " : "", files[i].type);
}

/* Names that only a file has, of what isn't written. */
static bool is_foreign(const char *type) {
    static const char *const types[] = {
        "off", "csv", "txt",   "asc", "pts",     "ptx",  "e57",  "gltf", "gz",   "zst", "zip", "fbx", "dae",
        "3ds", "3mf", "wrl",   "x3d", "usd",     "usdz", "vtk",  "vtp",  "vtu",  "dxf", "dwg", "stp", "step",
        "igs", "ifc", "drc",   "npy", "npz",     "h5",   "hdf5", "rcp",  "rcs",  "bin", "fls", "zfs", "pod",
        "bpf", "abc", "blend", "mtl", "parquet", "jpeg", "jpg",  "tif",  "tiff", "svg", "pdf", "html"};
    for (size_t i = 0; i < sizeof types / sizeof *types; i++)
        if (strcasecmp(types[i], type) == 0) return true;
    return false;
}

static enum status refuse_foreign(const char *type, struct error *error) {
    char types[128];
    join_types(types, sizeof types);
    return error_set(error, STATUS_BAD_PARAMETER, "output",
                     "no .%s is written; use one of %s, or a folder, which ends in /", type, types);
}

/* A folder of tiles: named by its tileset.json, or NAME.3dtiles. */
static bool is_tileset_folder(const struct command_options *options) {
    const char *end = options->output + strlen(options->output), *name = "tileset.json";
    size_t length = strlen(name);
    if ((size_t)(end - options->output) >= length && strcmp(end - length, name) == 0)
        return end - length == options->output || end[-(ptrdiff_t)length - 1] == '/';
    while (end > options->output && end[-1] == '/') end--;
    name = ".3dtiles";
    length = strlen(name);
    return (size_t)(end - options->output) > length && strncmp(end - length, name, length) == 0;
}

static enum status settle_tileset_folder(struct command_options *options, struct error *error) {
    size_t length = strlen(options->output);
    const char *slash = strrchr(options->output, '/');
    if (options->params.levels.count || (options->outputs_given && !(options->params.outputs & OUTPUT_TILESET)))
        return error_set(error, STATUS_BAD_PARAMETER, "output",
                         "%s takes a tileset, of one level; use --outputs tileset, or another folder", options->output);
    if (length >= sizeof "tileset.json" - 1 &&
        strcmp(options->output + length - (sizeof "tileset.json" - 1), "tileset.json") == 0)
        length = slash ? (size_t)(slash - options->output) + (slash == options->output) : 0;
    options->tileset_folder = strndup(length ? options->output : ".", length ? length : 1);
    if (!options->tileset_folder) return error_set(error, STATUS_NO_MEMORY, "output", "no memory");
    options->output = options->tileset_folder;
    if (!options->outputs_given) options->params.outputs = OUTPUT_TILESET;
    return STATUS_OK;
}

enum status command_output_settle(struct command_options *options, struct error *error) {
    if (is_tileset_folder(options)) return settle_tileset_folder(options, error);
    const char *type = extension(options->output);
    uint32_t outputs = options->params.outputs;
    struct stat about;
    if (!type[0] || (stat(options->output, &about) == 0 && S_ISDIR(about.st_mode))) return STATUS_OK;
    if (is_foreign(type) && !find_file(type, NULL)) return refuse_foreign(type, error);
    if (!find_file(type, NULL)) return STATUS_OK;
    if (options->params.levels.count || (options->outputs_given && (outputs & (outputs - 1)) != 0))
        return error_set(error, STATUS_BAD_PARAMETER, "output",
                         "%s takes one output, of one level; use --outputs to name one, or a folder", options->output);
    const struct file *asked = options->outputs_given ? file_of_bit(outputs) : NULL;
    const struct file *file = find_file(type, asked);
    if (!file || (asked && file != asked && !is_general(asked)))
        return error_set(error, STATUS_BAD_PARAMETER, "output", "%s isn't a name for what --outputs asks for, %s.%s",
                         options->output, asked->stem, asked->type);
    options->params.outputs = file->bit;
    options->to_file = true;
    return STATUS_OK;
}

enum status command_output_settle_faces(struct command_options *options, const struct cloud *cloud,
                                        struct error *error) {
    const struct file *now = file_of_bit(options->params.outputs), *mesh = file_of_bit(OUTPUT_MESH);
    const struct file *meshed = find_file(now->type, mesh);
    bool faces = cloud->triangle_count > 0;
    if (faces && meshed && !options->to_standard) options->params.outputs = meshed->bit;
    if (faces || !is_kind(now, mesh)) return STATUS_OK;
    return error_set(error, STATUS_BAD_PARAMETER, "output",
                     ".%s holds faces, and the input has none; use whittle without convert to reconstruct them",
                     now->type);
}

static bool is_mesh(const struct cloud *cloud) {
    size_t used = 0;
    uint8_t *has_face = cloud->triangle_count ? alloc_zeroed(cloud->count, sizeof *has_face) : NULL;
    for (size_t t = 0; has_face && t < cloud->triangle_count; t++)
        for (int k = 0; k < 3; k++) {
            used += !has_face[cloud->triangle[t][k]];
            has_face[cloud->triangle[t][k]] = 1;
        }
    free(has_face);
    return used > 0 && 2 * used >= cloud->count;
}

bool command_output_follow_faces(struct command_options *options, const struct cloud *cloud) {
    if (options->outputs_given || options->params.outputs & OUTPUT_ANY_MESH || !is_mesh(cloud)) return false;
    const struct file *now = file_of_bit(options->params.outputs & ~(uint32_t)OUTPUT_REPORT);
    const struct file *meshed = now ? find_file(now->type, file_of_bit(OUTPUT_MESH)) : NULL;
    if (meshed) options->params.outputs = meshed->bit | (options->params.outputs & OUTPUT_REPORT);
    return meshed != NULL;
}

/* ------------------------------------------------------------------------------------------------ beforehand */

static struct file_out_rule make_rule(const struct command_options *options, const struct command_inputs *inputs) {
    struct file_out_rule rule = {.replaces = options->force || options->output_given};
    rule.source = inputs->source;
    rule.source_count = inputs->source_count;
    return rule;
}

static enum status check_folder(const struct command_options *options, struct error *error) {
    char given[PATH_MAX], path[PATH_MAX + 2];
    if (strlen(options->output) >= PATH_MAX) return refuse_name(options, error);
    snprintf(given, sizeof given, "%s", options->output);
    const char *folder = options->to_file ? dirname(given) : given;
    snprintf(path, sizeof path, "%s/.", folder);
    if (access(path, W_OK | X_OK) == 0) return STATUS_OK;
    if (errno != ENOENT || options->to_file)
        return error_set(error, status_from_errno(errno), "output", "can't write into the folder %s: %s", folder,
                         strerror(errno));
    snprintf(path, sizeof path, "%s", folder);
    if (access(dirname(path), W_OK | X_OK) == 0) return STATUS_OK;
    return error_set(error, status_from_errno(errno), "output", "can't make the folder %s: %s", folder,
                     strerror(errno));
}

/* What was found, and what to do.  The last of several names may have been meant as an input, as in `whittle *.ply`. */
static enum status refuse_file(const struct command_options *options, const char *path, enum file_out_claim claim,
                               struct error *error) {
    static const char *const advice[] = {[FILE_OUT_TAKEN] = "use --force to replace it, or -o for another place",
                                         [FILE_OUT_IS_SOURCE] = "use -o for another place",
                                         [FILE_OUT_IS_FOLDER] = "use -o for another place",
                                         [FILE_OUT_IS_SPECIAL] = "use -o - to write into it"};
    struct error found = {0};
    enum status status = file_out_refuse(path, claim, &found);
    if (status && claim == FILE_OUT_TAKEN && options->output_named && options->input_count > 1)
        return error_set(error, status, "output",
                         "%s, and the last name is the output; use -o OUTPUT where it is an input, else --force",
                         found.text);
    return status ? error_set(error, status, "output", "%s; %s", found.text, advice[claim]) : STATUS_OK;
}

/* `whittle cloud.ply -o - >> cloud.ply` would never end.  The index of COPC is behind its points. */
static enum status check_standard(const struct command_options *options, const struct file_out_rule *rule,
                                  struct error *error) {
    struct stat about;
    bool same = false;
    if (fstat(STDOUT_FILENO, &about) != 0) return STATUS_OK;
    for (size_t i = 0; i < rule->source_count; i++)
        same = same || (about.st_dev == rule->source[i].device && about.st_ino == rule->source[i].inode);
    if (same) return error_set(error, STATUS_BAD_PARAMETER, "output", "standard output is the input itself");
    bool fits = !(options->params.outputs & OUTPUT_CLOUD_COPC) || cloud_takes_copc(STDOUT_FILENO);
    return fits ? STATUS_OK
                : error_set(error, STATUS_BAD_PARAMETER, "output",
                            "COPC can't go into a pipe: where its index is stands in its head; use -o NAME.copc.laz");
}

enum status command_output_check(const struct command_options *options, const struct command_inputs *inputs,
                                 struct error *error) {
    struct file_out_rule rule = make_rule(options, inputs);
    struct plan plan;
    char path[PATH_MAX];
    if (options->to_standard) return check_standard(options, &rule, error);
    enum status status = check_folder(options, error);
    if (status || inputs->failed) return status;
    make_plan(&options->params, &plan);
    for (size_t i = 0; i < plan.count && !status; i++)
        status = name_file(options, &plan.item[i], path) ? refuse_file(options, path, file_out_look(path, &rule), error)
                                                         : refuse_name(options, error);
    return status;
}

/* How large a file is, where there is one. */
static void put_size(const char *path, FILE *to) {
    static const char *const units[] = {"bytes", "KiB", "MiB", "GiB", "TiB"};
    struct stat found;
    size_t unit = 0;
    if (stat(path, &found) != 0 || !S_ISREG(found.st_mode)) return;
    double size = (double)found.st_size;
    for (; size >= 1024 && unit + 1 < sizeof units / sizeof *units; unit++) size /= 1024;
    fprintf(to, ", %.*f %s", unit && size < 100 ? 1 : 0, size, units[unit]);
}

void command_output_names(const struct command_options *options, const char *label, bool mark, FILE *to) {
    const struct file_out_rule rule = {.replaces = true};
    struct plan plan;
    char path[PATH_MAX];
    if (options->to_standard) return;
    make_plan(&options->params, &plan);
    for (size_t i = 0; i < plan.count; i++) {
        if (!name_file(options, &plan.item[i], path)) continue;
        bool replaces = mark && file_out_look(path, &rule) == FILE_OUT_REPLACES;
        fprintf(to, "%-16s %s%s", i ? "" : label, path, replaces ? " (replaces what is there)" : "");
        if (!mark) put_size(path, to);
        fputc('\n', to);
    }
}

enum status command_output_list(const struct command_options *options, char ***name, size_t *count) {
    struct plan plan;
    char path[PATH_MAX];
    *count = 0;
    *name = NULL;
    if (options->to_standard) return STATUS_OK;
    make_plan(&options->params, &plan);
    *name = alloc_zeroed(plan.count, sizeof **name);
    for (size_t i = 0; *name && i < plan.count; i++) {
        if (!name_file(options, &plan.item[i], path)) continue;
        char *copy = alloc_array(strlen(path) + 1, 1);
        if (!copy) return STATUS_NO_MEMORY;
        memcpy(copy, path, strlen(path) + 1);
        (*name)[(*count)++] = copy;
    }
    return *name ? STATUS_OK : STATUS_NO_MEMORY;
}

/* ------------------------------------------------------------------------------------------------ writing */

static enum status commit_files(struct outputs *outputs, struct error *error) {
    size_t count = outputs->files;
    outputs->files = 0;
    return count ? file_out_commit(outputs->file, count, error) : STATUS_OK;
}

/* What goes wrong in writing is told of the output, not of the input. */
static void name_output(const char *path, struct error *error) {
    char text[ERROR_TEXT_BYTES];
    if (strcmp(error->where, "write") != 0) return;
    memcpy(text, error->text, sizeof text);
    snprintf(error->text, sizeof error->text, "%.110s: %.190s", path, text);
}

static enum status write_file(struct outputs *outputs, const struct planned *item, struct error *error) {
    char path[PATH_MAX];
    struct file_out *out = &outputs->file[outputs->files];
    if (!name_file(outputs->options, item, path)) return refuse_name(outputs->options, error);
    enum status status = file_out_begin(out, path, error);
    if (status) return status;
    out->rule = &outputs->rule;
    outputs->files++;
    outputs->level = &outputs->result->level[item->level];
    status = item->file->write(out->fd, outputs, error);
    if (status && outputs->options->progress_fd < 0) name_output(path, error);
    return !status && outputs->files == MOST_OPEN ? commit_files(outputs, error) : status;
}

/* The lines of what the input's reader left out. */
static void note_input(const struct command_options *options, const struct cloud *cloud, struct left_out *left_out) {
    uint32_t outputs = options->params.outputs;
    if (options->to_file && !options->outputs_given && !(outputs & OUTPUT_ANY_MESH) && is_mesh(cloud))
        left_out_add(left_out, "input", "its faces, which a .%s has not; use .ply, .obj, .stl or .glb",
                     file_of_bit(outputs)->type);
    if (cloud->las && cloud->las->has_crs && outputs & (OUTPUT_ANY_CLOUD | OUTPUT_ANY_MESH) & ~(uint32_t)OUTPUT_ANY_LAS)
        left_out_add(left_out, "input", "the coordinate system, except in cloud.las, cloud.laz and cloud.copc.laz");
    bool is_newer = outputs & OUTPUT_CLOUD_COPC || (cloud->las && cloud->las->format >= 6 && outputs & OUTPUT_ANY_LAS);
    if (is_newer && cloud->las && las_system_is_keys(cloud->las))
        left_out_add(left_out, "input",
                     "the coordinate system as text (WKT), which LAS 1.4 and COPC are to have: the GeoTIFF keys go on");
    for (const char *at = cloud->left_out; at && *at;) {
        size_t n = strcspn(at, "\n");
        left_out_add(left_out, "input", "%.*s", (int)n, at);
        at += n + (at[n] == '\n');
    }
}

/* The one output, to standard output. */
static enum status write_standard(struct outputs *outputs, struct error *error) {
    size_t i = 0;
    while (i + 1 < FILES && !(outputs->options->params.outputs & files[i].bit)) i++;
    enum status status = files[i].write(STDOUT_FILENO, outputs, error);
    if (status && outputs->options->progress_fd < 0) name_output("standard output", error);
    return status;
}

static enum status write_files(struct outputs *outputs, struct error *error) {
    struct plan plan;
    enum status status = STATUS_OK;
    make_plan(&outputs->options->params, &plan);
    for (size_t i = 0; i < plan.count && !status; i++) status = write_file(outputs, &plan.item[i], error);
    return status ? status : commit_files(outputs, error);
}

static enum status write_folder(struct outputs *outputs, struct error *error) {
    const char *folder = outputs->options->output;
    bool makes = !outputs->options->to_file, made = makes && mkdir(folder, 0777) == 0;
    if (makes && !made && errno != EEXIST)
        return error_set(error, status_from_errno(errno), "output", "can't make the folder %s: %s", folder,
                         strerror(errno));
    enum status status = write_files(outputs, error);
    for (size_t i = 0; i < outputs->files; i++) file_out_abort(&outputs->file[i]);
    if (status && made) (void)rmdir(folder); /* where nothing is in it */
    return status;
}

/* ------------------------------------------------------------------------------------------------ attributes */

static bool has_moved_vertex(const struct mesh *mesh) {
    for (size_t v = 0; v < mesh->vertex_count; v++)
        if (mesh->source[v] == NONE) return true;
    return false;
}

/* Whether vertices have other attributes than their points. */
static bool wants_vertices(const struct outputs *o, const struct mesh *mesh) {
    const struct params *params = &o->options->params;
    if (!(params->outputs & OUTPUT_ANY_MESH) || !mesh->vertex_count) return false;
    return params->attributes == ATTRIBUTES_MEAN || has_moved_vertex(mesh);
}

static enum status find_vertices(struct outputs *o, struct error *error) {
    const struct params *params = &o->options->params;
    size_t most = 0;
    enum status status = STATUS_OK;
    for (size_t i = 0; !status && i < o->result->level_count; i++) {
        const struct mesh *mesh = &o->result->level[i].mesh;
        if (!wants_vertices(o, mesh)) continue;
        if (mesh->vertex_count > most) most = mesh->vertex_count;
        status =
            attributes_at(o->cloud, mesh->vertex, mesh->source, mesh->vertex_count,
                          params->attributes == ATTRIBUTES_MEAN, (unsigned)params->threads, &o->vertices[i], error);
        if (!status && o->result->normal && attributes_turn_normals(&o->vertices[i], mesh))
            status = error_set(error, STATUS_NO_MEMORY, "attributes", "no memory");
        if (!status && o->cloud->comments) o->vertices[i].comments = strdup(o->cloud->comments);
    }
    if (!status && most) o->number = calloc(most, sizeof *o->number);
    if (!status && most && !o->number) status = error_set(error, STATUS_NO_MEMORY, "attributes", "no memory");
    for (size_t v = 0; o->number && v < most; v++) o->number[v] = (uint32_t)v;
    return status;
}

static void vertices_done(struct outputs *o) {
    for (size_t i = 0; i < PARAMS_MAX_LEVELS; i++) cloud_done(&o->vertices[i]);
    free(o->number);
}

enum status command_output_write(const struct command_options *options, const struct command_inputs *inputs,
                                 const struct cloud *cloud, const struct kept_file *file,
                                 struct pipeline_result *result, struct error *error) {
    struct outputs outputs = {.options = options,
                              .cloud = cloud,
                              .kept = file && file->path ? file : NULL,
                              .result = result,
                              .level = &result->level[0],
                              .rule = make_rule(options, inputs),
                              .left_out = &result->report.left_out};
    note_input(options, cloud, outputs.left_out);
    if (outputs.kept && (options->params.outputs & ~(uint32_t)OUTPUT_REPORT) != OUTPUT_TILESET)
        return error_set(error, STATUS_BAD_PARAMETER, "outputs",
                         "what is kept doesn't fit into memory: a tileset is all that can be made of it");
    enum status status = find_vertices(&outputs, error);
    if (!status) status = options->to_standard ? write_standard(&outputs, error) : write_folder(&outputs, error);
    vertices_done(&outputs);
    return status;
}

static void print_distances(FILE *to, const char *name, const struct distance_stats *stats, double diagonal) {
    if (!stats->count) return;
    fprintf(to, "%-16s %10.4g %10.4g %10.4g %10.4g %10.4g %10.4g\n", name, stats->mean, stats->rms, stats->max,
            1e4 * stats->mean / diagonal, 1e4 * stats->rms / diagonal, 1e4 * stats->max / diagonal);
}

/* Whether an earlier level has this warning too. */
static bool was_warned(const struct report *report, size_t level, const char *warning) {
    char earlier[REPORT_WARNING_BYTES];
    for (size_t i = 0; i < level; i++)
        for (size_t n = 0; report_warning(report, &report->level[i], n, earlier, sizeof earlier); n++)
            if (strcmp(earlier, warning) == 0) return true;
    return false;
}

static void print_warnings(const struct report *report, size_t level, FILE *to) {
    char warning[REPORT_WARNING_BYTES];
    for (size_t n = 0; report_warning(report, &report->level[level], n, warning, sizeof warning); n++)
        if (!was_warned(report, level, warning)) fprintf(to, "%-16s %s\n", "warning", warning);
}

static const char *plural(uint64_t count) { return count == 1 ? "" : "s"; }

static void summarise_result(const struct report *report, FILE *to) {
    const struct report_level *r = &report->level[0];
    fprintf(to, "%-16s %" PRIu64 " of %" PRIu64 "\n", "points", r->points_out, report->points_in);
    if (r->has_mesh)
        fprintf(to, "%-16s %" PRIu64 " triangle%s, %s, %" PRIu64 " kept point%s lost\n", "mesh", r->triangles,
                plural(r->triangles), r->watertight ? "watertight" : "open", r->points_lost, plural(r->points_lost));
    if (r->has_mesh && !r->watertight)
        fprintf(to, "%-16s %" PRIu64 ", %.4g long in the file's units\n", "borders", r->borders, r->border_length);
    if (r->holes_closed) fprintf(to, "%-16s %" PRIu64 " closed\n", "holes", r->holes_closed);
    if (r->tangent.count || r->has_mesh) { /* there are none to points that memory doesn't hold */
        fprintf(to, "%-16s %32s %32s\n", "distances", "in the file's units", "in 1e-4 of the diagonal");
        fprintf(to, "%-16s %10s %10s %10s %10s %10s %10s\n", "", "mean", "rms", "max", "mean", "rms", "max");
    }
    print_distances(to, "input to planes", &r->tangent, report->diagonal);
    print_distances(to, "input to mesh", &r->input_to_mesh, report->diagonal);
    print_distances(to, "surface to mesh", &r->surface_to_mesh, report->diagonal);
    print_distances(to, "mesh to input", &r->mesh_to_input, report->diagonal);
    print_distances(to, "symmetric", &r->symmetric, report->diagonal);
    print_distances(to, "dropped to mesh", &r->dropped, report->diagonal);
    print_warnings(report, 0, to);
}

static void print_level_row(const struct report *report, const struct report_level *r, double ratio, FILE *to) {
    const struct distance_stats *stats = r->has_mesh ? &r->symmetric : &r->tangent;
    fprintf(to, "%-16.10g %10" PRIu64, ratio, r->points_out);
    if (r->has_mesh) fprintf(to, " %10" PRIu64, r->triangles);
    if (stats->count)
        fprintf(to, " %10.4g %10.4g %10.4g %10.4g", stats->mean, stats->max, 1e4 * stats->mean / report->diagonal,
                1e4 * stats->max / report->diagonal);
    if (r->has_mesh && r->watertight) fputs(" watertight", to);
    if (r->has_mesh && !r->watertight) fprintf(to, " open, %" PRIu64 " border%s", r->borders, plural(r->borders));
    if (r->holes_closed) fprintf(to, ", %" PRIu64 " hole%s closed", r->holes_closed, plural(r->holes_closed));
    if (r->points_lost) fprintf(to, ", %" PRIu64 " kept point%s lost", r->points_lost, plural(r->points_lost));
    fputc('\n', to);
}

/* A row for each: of the distances those of both directions, or to planes where there are no meshes.  The report has
 * all others. */
static void summarise_levels(const struct command_options *options, const struct report *report, FILE *to) {
    bool meshes = report->level[0].has_mesh, distances = meshes || report->level[0].tangent.count;
    fprintf(to, "%-16s %" PRIu64 "\n", "points", report->points_in);
    fprintf(to, "%-*s", meshes ? 38 : 27, meshes ? "levels, symmetric distances" : "levels, distances to planes");
    if (distances) fprintf(to, " %21s %21s", "in the file's units", "in 1e-4 of diagonal");
    fprintf(to, "\n%-16s %10s", "ratio", "points");
    if (meshes) fprintf(to, " %10s", "triangles");
    if (distances) fprintf(to, " %10s %10s %10s %10s", "mean", "max", "mean", "max");
    fputc('\n', to);
    for (size_t i = 0; i < report->level_count; i++)
        print_level_row(report, &report->level[i], options->params.levels.ratio[i], to);
    for (size_t i = 0; i < report->level_count; i++) print_warnings(report, i, to);
}

/* What is told of in the report's left_out, by how it begins. */
static const struct loss_kind {
    const char *label, *begin;
} loss_kinds[] = {{"warning", LEFT_OUT_WARNING}, {"note", LEFT_OUT_NOTE}, {"left out", ""}};
enum { LOSS_KINDS = sizeof loss_kinds / sizeof *loss_kinds };

static const struct loss_kind *kind_of_loss(const char *what) {
    size_t k = 0;
    while (strncmp(what, loss_kinds[k].begin, strlen(loss_kinds[k].begin)) != 0) k++; /* "" begins all */
    return &loss_kinds[k];
}

static void print_losses(const struct left_out *left_out, FILE *to) {
    for (const struct loss_kind *kind = loss_kinds; kind < loss_kinds + LOSS_KINDS; kind++) {
        const char *label = kind->label;
        for (size_t i = 0; i < left_out->count; i++) {
            const char *what = left_out->loss[i].what;
            if (kind_of_loss(what) != kind) continue;
            fprintf(to, "%-16s %s: %s\n", label, left_out->loss[i].where, what + strlen(kind->begin));
            label = "";
        }
    }
}

void command_output_warn(const struct report *report, FILE *to) {
    char warning[REPORT_WARNING_BYTES];
    for (size_t i = 0; i < report->level_count; i++)
        for (size_t n = 0; report_warning(report, &report->level[i], n, warning, sizeof warning); n++)
            if (!was_warned(report, i, warning)) fprintf(to, "whittle: warning: %s\n", warning);
    for (size_t i = 0; i < report->left_out.count; i++) {
        const char *what = report->left_out.loss[i].what;
        if (kind_of_loss(what) == loss_kinds)
            fprintf(to, "whittle: warning: %s: %s\n", report->left_out.loss[i].where, what + strlen(LEFT_OUT_WARNING));
    }
}

void command_output_converted(const struct command_options *options, const struct cloud *cloud,
                              const struct left_out *left_out, FILE *to) {
    fprintf(to, "%-16s %zu\n", "points", cloud->count);
    if (options->params.outputs & OUTPUT_ANY_MESH) fprintf(to, "%-16s %zu triangles\n", "mesh", cloud->triangle_count);
    print_losses(left_out, to);
    command_output_names(options, "written", false, to);
}

static void print_count(FILE *to, const char *label, uint64_t points) {
    if (points) fprintf(to, "%-16s %" PRIu64 " point%s\n", label, points, plural(points));
}

static void print_deviation(const struct report_deviation *deviation, FILE *to) {
    fprintf(to, "%-16s %.4g", "deviation", deviation->reached);
    if (deviation->share < 1) fprintf(to, " of %.6g %% of the points", 100 * deviation->share);
    fprintf(to, ", %.4g allowed", deviation->bound);
    if (deviation->share < 1) fprintf(to, ", %" PRIu64 " points are farther", deviation->points_over);
    fprintf(to, ", found with %" PRIu64 " %s\n", deviation->tried, deviation->tried == 1 ? "try" : "tries");
}

void command_output_summary(const struct command_options *options, const struct report *report, FILE *to) {
    if (report->level_count > 1)
        summarise_levels(options, report, to);
    else
        summarise_result(report, to);
    const struct report_deviation *deviation = &report->deviation;
    if (report->surface.kind[0])
        fprintf(to, "%-16s %s: %s; sides by %s\n", "surface", report->surface.kind, report->surface.reason,
                report->surface.orientation);
    if (report->normals.orientation[0])
        fprintf(to, "%-16s %s, sides by %s\n", "normals", report->normals.given ? "given" : "computed",
                report->normals.orientation);
    if (report->spacing.spacing > 0)
        fprintf(to, "%-16s %.4g, for which %s%" PRIu64 " points have room\n", "spacing", report->spacing.spacing,
                report->spacing.at_least ? "at least " : "", report->spacing.points);
    if (deviation->bound > 0) print_deviation(deviation, to);
    print_count(to, "cropped", report->points_cropped);
    print_count(to, "filtered", report->points_filtered);
    print_count(to, "outliers", report->points_outliers);
    if (report->noise_level > 0)
        fprintf(to, "%-16s %.3g in the file's units, estimated\n", "noise", report->noise_level);
    if (report->denoised[0]) fprintf(to, "%-16s %s\n", "denoised", report->denoised);
    if (report->noise > 0) fprintf(to, "%-16s %.3e of the diagonal\n", "smoothed", report->noise / report->diagonal);
    print_losses(&report->left_out, to);
    for (size_t i = 0; options->verbose && i < report->stage_count; i++)
        fprintf(to, "%-16s %-12s %10.1f ms\n", i ? "" : "stages", report->stage[i].name, report->stage[i].wall_ms);
    fprintf(to, "%-16s %.0f ms, %.1f MiB at the peak\n", "cost", report->total_ms,
            (double)report->peak_rss_bytes / 1048576);
    command_output_names(options, "written", false, to);
}

void command_output_explain(const char *input, enum status status, const struct error *error, FILE *to) {
    if (strcmp(error->where, "write") == 0 && strncmp(error->text, "can't write:", 12) != 0) { /* it names the output */
        fprintf(to, "whittle: %s\n", error->text[0] ? error->text : status_name(status));
        return;
    }
    fprintf(to, "whittle: %s: ", input);
    if (error->line) fprintf(to, "line %" PRIu64 ": ", error->line);
    if (!error->line && error->byte_offset != UINT64_MAX && error->code)
        fprintf(to, "byte %" PRIu64 ": ", error->byte_offset);
    if (error->where[0]) fprintf(to, "%s: ", error->where);
    fprintf(to, "%s\n", error->text[0] ? error->text : status_name(status));
}
