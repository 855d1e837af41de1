/* Three pictures under one camera, each with a line of words above it; a scale bar below the first one and a legend
 * below the last.
 *
 *     before | after | deviation      words, TOP high
 *            |       |                size wide, as high as the view
 *     |---|          |  === legend    BOTTOM high
 *
 * Before and deviation are the same points in other colours, so they are drawn once.  Points are discs as large as the
 * way to their neighbours, so that a surface closes and a stray stays small.
 *
 * The deviation's colours end where one point in fifty is beyond: a few extreme values would leave all others pale.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/picture/picture.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/math/quantile.h"
#include "core/picture/canvas.h"
#include "core/picture/lettering.h"
#include "core/spatial/knn.h"

enum { FACTOR = PICTURE_FACTOR, NEIGHBOURS = 6, CHUNK = 1024, TEXT_BYTES = 96 };
_Static_assert(sizeof(struct sample) <= PICTURE_SAMPLE_BYTES, "memory is predicted by it");
static const double ROUNDED_REL = 1e-12; /* of the diagonal: smaller deviations are of rounding, and have no colour */
static const double SHOWN = 0.98;        /* of the points are within the colours of the legend */
static const double DISC_REACH = 1.1; /* a disc's radius, as a multiple of the way to the farthest of its neighbours */
static const double DISC_MOST = 2.5;  /* and of the median radius */
static const unsigned char BACKGROUND[3] = {250, 250, 248}, INK[3] = {58, 62, 70}, CLAY[3] = {203, 196, 186};

/* From nothing lost to the largest: light, so that the shape shows, over amber to dark red. */
static const unsigned char RAMP[][3] = {{222, 224, 226}, {250, 220, 138}, {247, 150, 58}, {214, 52, 38}, {112, 6, 44}};
enum { STOPS = sizeof RAMP / sizeof RAMP[0] };

void picture_done(struct picture *picture) {
    free(picture->rgb);
    *picture = (struct picture){0};
}

void picture_deviation_colour(double share, unsigned char rgb[3]) {
    double at = fmin(fmax(share, 0), 1) * (STOPS - 1);
    int stop = at < STOPS - 2 ? (int)at : STOPS - 2;
    for (int c = 0; c < 3; c++)
        rgb[c] = (unsigned char)(RAMP[stop][c] + (at - stop) * (RAMP[stop + 1][c] - RAMP[stop][c]) + 0.5);
}

/* ------------------------------------------------------------------------------------------------ points */

struct colours {
    const struct property *rgb[3]; /* NULL = the cloud has none */
    double scale;                  /* of a number, so that it becomes 8 bits */
};

/* In LAS of a format with colours all are 0 where the points were never given any. */
static bool is_black(const struct cloud *cloud, const struct colours *colours) {
    for (size_t i = 0; i < cloud->count; i++)
        for (int c = 0; c < 3; c++) {
            const struct property *p = colours->rgb[c];
            if (scalar_load(&cloud->record[i * cloud->record_bytes + p->offset_bytes], p->type) > 0) return false;
        }
    return true;
}

static struct colours find_colours(const struct cloud *cloud) {
    static const char *const names[3] = {"red", "green", "blue"};
    struct colours found = {.scale = 1};
    for (size_t j = 0; j < cloud->property_count; j++)
        for (int c = 0; c < 3; c++)
            if (!cloud->property[j].is_list && strcmp(cloud->property[j].name, names[c]) == 0)
                found.rgb[c] = &cloud->property[j];
    if (!found.rgb[0] || !found.rgb[1] || !found.rgb[2] || is_black(cloud, &found)) return (struct colours){.scale = 1};
    if (found.rgb[0]->type == SCALAR_UINT16) found.scale = 1 / 257.0;
    if (found.rgb[0]->type == SCALAR_FLOAT32 || found.rgb[0]->type == SCALAR_FLOAT64) found.scale = 255;
    return found;
}

static void colour_of(const struct cloud *cloud, const struct colours *colours, size_t id, float linear[3]) {
    const unsigned char *record = &cloud->record[id * cloud->record_bytes];
    for (int c = 0; c < 3; c++) {
        const struct property *p = colours->rgb[c];
        double value = p ? scalar_load(record + p->offset_bytes, p->type) * colours->scale : CLAY[c];
        linear[c] = canvas_linear((unsigned char)(fmin(fmax(value, 0), 255) + 0.5));
    }
}

/* Whether a point is drawn: of many points an even choice by their numbers, whatever order they come in. */
static bool is_drawn(uint64_t id, uint64_t count) {
    uint64_t h = (id + 1) * 0x9e3779b97f4a7c15u;
    h = (h ^ h >> 32) * 0xd6e8feb86659fd93u;
    return count <= PICTURE_MOST_POINTS || (double)(h >> 11) * 0x1p-53 * (double)count < 0.95 * PICTURE_MOST_POINTS;
}

struct dots {
    const struct picture_scene *scene;
    const struct view *view;
    struct colours colours;
    size_t count;
    uint32_t *id;        /* into the cloud; owned */
    vec3 *point;         /* owned */
    struct splat *splat; /* owned */
    const struct knn *knn;
};

static void dots_done(struct dots *dots) { free(dots->id), free(dots->point), free(dots->splat); }

/* Chooses among n points, those of kept or (NULL) the first ones. */
static enum status choose_dots(struct dots *dots, const uint32_t *kept, size_t n) {
    size_t most = n < PICTURE_MOST_POINTS ? n : PICTURE_MOST_POINTS;
    dots->id = alloc_array(most, sizeof *dots->id);
    dots->point = alloc_array(most, sizeof *dots->point);
    dots->splat = alloc_array(most, sizeof *dots->splat);
    if (!dots->id || !dots->point || !dots->splat) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < n && dots->count < most; i++) {
        if (!is_drawn(i, n)) continue;
        uint32_t id = kept ? kept[i] : (uint32_t)i;
        dots->id[dots->count] = id;
        dots->point[dots->count++] = dots->scene->cloud->position[id];
    }
    return STATUS_OK;
}

static void make_splat(const struct dots *dots, size_t i, double reach_sq) {
    const struct picture_scene *scene = dots->scene;
    struct splat *s = &dots->splat[i];
    uint32_t id = dots->id[i];
    vec3 at = view_project(dots->view, dots->point[i]), n = {0, 0, 1};
    if (scene->normal)
        n = view_turn(dots->view,
                      (vec3){(double)scene->normal[id][0], (double)scene->normal[id][1], (double)scene->normal[id][2]});
    if (vec3_length_sq(n) < 0.5) n = (vec3){0, 0, 1};
    if (n.z < 0) n = vec3_scale(n, -1);
    *s = (struct splat){(float)at.x, (float)at.y, (float)at.z, .normal = {(float)n.x, (float)n.y, (float)n.z}};
    s->radius = (float)fmin(DISC_REACH * sqrt(reach_sq) * dots->view->scale, dots->view->width / 16);
    s->value = scene->deviation ? scene->deviation[id] : 0;
    colour_of(scene->cloud, &dots->colours, id, s->colour);
}

/* How far off the farthest of the neighbours is that there are, squared. */
static double point_reach_sq(const double *distance_sq) {
    for (int k = NEIGHBOURS; k-- > 1;)
        if (isfinite(distance_sq[k])) return distance_sq[k];
    return INFINITY;
}

/* Knn has the memory for chunks of this size on the stack, so this doesn't fail where knn_new didn't; a radius that
 * isn't known becomes the largest. */
static void make_splats(void *ctx, size_t begin, size_t end) {
    const struct dots *dots = ctx;
    uint32_t nearest[CHUNK * NEIGHBOURS];
    double distance_sq[CHUNK * NEIGHBOURS];
    for (size_t at = begin; at < end; at += CHUNK) {
        size_t n = end - at < CHUNK ? end - at : CHUNK;
        bool known = !knn_search(dots->knn, &dots->point[at], n, NEIGHBOURS, 1, nearest, distance_sq);
        for (size_t i = 0; i < n; i++)
            make_splat(dots, at + i, known ? point_reach_sq(&distance_sq[i * NEIGHBOURS]) : INFINITY);
    }
}

/* No disc is much larger than most, nor smaller than what holds a sample for sure. */
static enum status bound_radii(struct dots *dots) {
    float *radius = alloc_array(dots->count, sizeof *radius);
    if (!radius) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < dots->count; i++) radius[i] = dots->splat[i].radius;
    float most = (float)DISC_MOST * quantile_of(radius, dots->count, 0.5), least = 0.75f;
    for (size_t i = 0; i < dots->count; i++) dots->splat[i].radius = fmaxf(fminf(dots->splat[i].radius, most), least);
    free(radius);
    return STATUS_OK;
}

/* Draws n points of the scene's cloud. */
static enum status draw_dots(const struct picture_scene *scene, const struct view *view, const uint32_t *kept, size_t n,
                             unsigned threads, struct canvas *canvas) {
    struct dots dots = {.scene = scene, .view = view, .colours = find_colours(scene->cloud)};
    struct knn *knn = NULL;
    enum status status = choose_dots(&dots, kept, n);
    if (!status) status = knn_new(dots.point, dots.count, threads, &knn, NULL);
    dots.knn = knn;
    if (!status) par_for(threads, dots.count, CHUNK, make_splats, &dots);
    knn_free(knn);
    if (!status) status = bound_radii(&dots);
    if (!status) canvas_splats(canvas, dots.splat, dots.count, threads);
    dots_done(&dots);
    return status;
}

/* ------------------------------------------------------------------------------------------------ meshes */

static enum status draw_mesh(const struct picture_scene *scene, const struct view *view, unsigned threads,
                             struct canvas *canvas) {
    const struct mesh *mesh = scene->mesh;
    struct colours colours = find_colours(scene->cloud), none = {.scale = 1};
    struct corner *corner = alloc_array(mesh->vertex_count, sizeof *corner);
    if (!corner) return STATUS_NO_MEMORY;
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        vec3 at = view_project(view, mesh->vertex[v]);
        uint32_t id = mesh->source ? mesh->source[v] : NONE;
        corner[v] = (struct corner){.x = (float)at.x, .y = (float)at.y, .depth = (float)at.z};
        colour_of(scene->cloud, id == NONE ? &none : &colours, id == NONE ? 0 : id, corner[v].colour);
    }
    canvas_triangles(canvas, corner, (const uint32_t(*)[3])mesh->triangle, mesh->triangle_count, threads);
    free(corner);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the page */

/* The parts of the picture, in pixels. */
struct page {
    size_t size, height; /* of each of the pictures */
    size_t gap, top, bottom;
    double letters; /* how high figures are */
    size_t pictures;
};

static struct page lay_out(const struct view *view, const struct picture_view *wanted, bool has_deviation) {
    struct page page = {.size = wanted->size, .height = (size_t)(view->height / FACTOR)};
    page.letters = fmax(8, (double)wanted->size / 40);
    page.gap = wanted->size / 40 + 1;
    page.top = (size_t)(3.2 * page.letters);
    page.bottom = (size_t)(4.6 * page.letters);
    page.pictures = has_deviation ? 3 : 2;
    return page;
}

static size_t left_of(const struct page *page, size_t i) { return page->gap + i * (page->size + page->gap); }

static void write_head(struct picture *to, const struct page *page, size_t i, const char *title, const char *figures) {
    static const unsigned char soft[3] = {120, 124, 132};
    double x = (double)left_of(page, i) + page->letters / 2, y = 2.1 * page->letters;
    lettering_write(to, x, y, page->letters, INK, title);
    x += lettering_width(title, page->letters) + page->letters;
    lettering_write(to, x, y, 0.85 * page->letters, soft, figures);
}

/* Digits in groups of three. */
static void put_count(char *text, size_t bytes, uint64_t count, const char *unit) {
    char plain[24];
    size_t n = (size_t)snprintf(plain, sizeof plain, "%" PRIu64, count), used = 0;
    for (size_t i = 0; i < n && used + 2 < bytes; i++) {
        if (i && (n - i) % 3 == 0) text[used++] = ' ';
        text[used++] = plain[i];
    }
    snprintf(text + used, bytes - used, " %s", unit);
}

/* 1, 2 or 5 times a power of ten: the largest that isn't over x. */
static double round_below(double x) {
    double power = pow(10, floor(log10(x)));
    return x >= 5 * power ? 5 * power : x >= 2 * power ? 2 * power : power;
}

static void write_scale(struct picture *to, const struct page *page, const struct view *view) {
    double pixels = view->scale / FACTOR, length = round_below((double)page->size / 3 / pixels), wide = length * pixels;
    double x = (double)left_of(page, 0) + page->letters / 2;
    double y = (double)(page->top + page->height) + 1.7 * page->letters, tick = 0.35 * page->letters;
    char text[TEXT_BYTES];
    if (!isfinite(wide)) return;
    double pen = fmax(1.5, page->letters / 7);
    lettering_line(to, x, y, x + wide, y, pen, INK);
    lettering_line(to, x, y - tick, x, y + tick, pen, INK);
    lettering_line(to, x + wide, y - tick, x + wide, y + tick, pen, INK);
    snprintf(text, sizeof text, "%.6g", length);
    lettering_write(to, x + wide + page->letters, y + page->letters / 2, page->letters, INK, text);
}

static void write_legend(struct picture *to, const struct page *page, double shown, double largest) {
    size_t left = left_of(page, 2) + (size_t)(page->letters / 2), wide = page->size - (size_t)page->letters;
    size_t high = (size_t)page->letters, top = page->top + page->height + (size_t)(0.8 * page->letters);
    double baseline = (double)(top + high) + 1.7 * page->letters;
    char text[TEXT_BYTES];
    for (size_t y = top; y < top + high; y++)
        for (size_t x = 0; x < wide; x++)
            picture_deviation_colour((double)x / (double)(wide - 1), &to->rgb[3 * (y * to->width + left + x)]);
    for (int i = 0; i <= 2; i++) {
        snprintf(text, sizeof text, "%s%.3g", i == 2 && largest > 1.001 * shown ? ">" : "", shown * i / 2);
        double at = (double)left + (double)wide * i / 2 - lettering_width(text, page->letters) * i / 2;
        lettering_write(to, at, baseline, page->letters, INK, text);
    }
}

/* ------------------------------------------------------------------------------------------------ the whole */

struct legend {
    double shown; /* the value where the colours end; > 0 */
};

static void paint_deviation(void *ctx, float value, float colour[3]) {
    const struct legend *legend = ctx;
    unsigned char rgb[3];
    picture_deviation_colour((double)value / legend->shown, rgb);
    for (int c = 0; c < 3; c++) colour[c] = canvas_linear(rgb[c]);
}

static double diagonal_of(const struct cloud *cloud) {
    vec3 low = cloud->position[0], high = low;
    for (size_t i = 1; i < cloud->count; i++) {
        low = vec3_min(low, cloud->position[i]);
        high = vec3_max(high, cloud->position[i]);
    }
    return vec3_length(vec3_sub(high, low));
}

static enum status find_shown(const struct picture_scene *scene, struct legend *legend) {
    size_t n = scene->cloud->count;
    float *some = alloc_array(n, sizeof *some);
    if (!some) return STATUS_NO_MEMORY;
    memcpy(some, scene->deviation, n * sizeof *some);
    legend->shown = (double)quantile_of(some, n, SHOWN);
    if (!(legend->shown > 0)) legend->shown = (double)quantile_of(some, n, 1);
    double rounded = ROUNDED_REL * diagonal_of(scene->cloud);
    if (isfinite(rounded) && legend->shown < rounded) legend->shown = rounded;
    if (!(legend->shown > 0)) legend->shown = 1;
    free(some);
    return STATUS_OK;
}

static void put_canvas(const struct canvas *canvas, const struct page *page, size_t i, const struct canvas_show *show,
                       struct picture *to) {
    unsigned char *first = &to->rgb[3 * (page->top * to->width + left_of(page, i))];
    canvas_show(canvas, show, first, 3 * to->width);
}

/* Before and, with legend->shown, the deviation. */
static enum status show_before(const struct picture_scene *scene, const struct view *view, const struct page *page,
                               unsigned threads, struct legend *legend, struct picture *to) {
    struct canvas canvas = {0};
    struct canvas_show show = {.factor = FACTOR, .threads = threads};
    memcpy(show.background, BACKGROUND, sizeof show.background);
    enum status status = canvas_init(&canvas, page->size * FACTOR, page->height * FACTOR);
    if (!status) status = draw_dots(scene, view, NULL, scene->cloud->count, threads, &canvas);
    if (!status) canvas_light(&canvas, threads);
    if (!status) put_canvas(&canvas, page, 0, &show, to);
    show.paint = paint_deviation, show.ctx = legend;
    if (!status && scene->deviation) put_canvas(&canvas, page, 2, &show, to);
    canvas_done(&canvas);
    return status;
}

static bool has_mesh(const struct picture_scene *scene) { return scene->mesh && scene->mesh->triangle_count; }

static enum status show_after(const struct picture_scene *scene, const struct view *view, const struct page *page,
                              unsigned threads, struct picture *to) {
    struct canvas canvas = {0};
    struct canvas_show show = {.factor = FACTOR, .threads = threads};
    memcpy(show.background, BACKGROUND, sizeof show.background);
    enum status status = canvas_init(&canvas, page->size * FACTOR, page->height * FACTOR);
    if (!status && has_mesh(scene))
        status = draw_mesh(scene, view, threads, &canvas);
    else if (!status)
        status = draw_dots(scene, view, scene->kept, scene->kept_count, threads, &canvas);
    if (!status) canvas_light(&canvas, threads);
    if (!status) put_canvas(&canvas, page, 1, &show, to);
    canvas_done(&canvas);
    return status;
}

static void write_words(const struct picture_scene *scene, const struct view *view, const struct page *page,
                        const struct legend *legend, struct picture *to) {
    char text[TEXT_BYTES];
    put_count(text, sizeof text, scene->cloud->count, "points");
    write_head(to, page, 0, "before", text);
    put_count(text, sizeof text, has_mesh(scene) ? scene->mesh->triangle_count : scene->kept_count,
              has_mesh(scene) ? "triangles" : "points");
    write_head(to, page, 1, "after", text);
    write_scale(to, page, view);
    if (!scene->deviation) return;
    snprintf(text, sizeof text, "mean %.3g, largest %.3g", scene->mean, scene->largest);
    write_head(to, page, 2, "deviation", text);
    write_legend(to, page, legend->shown, scene->largest);
}

enum status picture_make(const struct picture_scene *scene, const struct picture_view *wanted, unsigned threads,
                         struct picture *picture) {
    struct view view;
    struct legend legend = {1};
    struct picture made = {0};
    enum status status = view_fit(scene->cloud->position, scene->cloud->count, wanted->up, wanted->azimuth,
                                  wanted->elevation, wanted->size * FACTOR, &view);
    if (!status && scene->deviation) status = find_shown(scene, &legend);
    if (status) return status;
    struct page page = lay_out(&view, wanted, scene->deviation);
    made.width = page.gap + page.pictures * (page.size + page.gap);
    made.height = page.top + page.height + page.bottom;
    made.rgb = alloc_array(made.width * made.height, 3);
    if (!made.rgb) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < made.width * made.height; i++) memcpy(&made.rgb[3 * i], BACKGROUND, 3);
    status = show_before(scene, &view, &page, threads, &legend, &made);
    if (!status) status = show_after(scene, &view, &page, threads, &made);
    if (!status)
        write_words(scene, &view, &page, &legend, &made), *picture = made;
    else
        picture_done(&made);
    return status;
}
