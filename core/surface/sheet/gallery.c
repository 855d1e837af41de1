/* Whoever scanned something has seen all of it, from places before it.  So of the two sides of the largest component
 * one is in front from which a few places together see the whole scan; from behind, what stands before it is hidden:
 *
 *      +-----------+
 *      |  ___      |       from g all is seen; of those who look at the walls from outside nobody sees the table's top
 *      |  | | g  o |       and feet from within, nor the lamp o
 *      +--+ +------+
 *
 * What is seen from places that see the largest component from one side only is summed up, most first (the art
 * gallery's guards, chosen greedily: Chvatal 1979).  Solids are seen from a few places around them.  Few places within
 * a solid that see nearly all of it there are only where it is round, and then outside is as good.  A room is seen from
 * within, all around, and most of its box is within it.
 *
 * The rays of guards pass a grid.  Before that, those who look along a few axes from infinitely far need none: what
 * hides a place from them lies above it in the plane across the axis.  Of most solids they see all.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/gallery.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/surface/sheet/occupancy.h"

enum { CELLS = 160, LOOKED_AT = 512 /* places of the mesh */, WITHIN = 6, AROUND = 3 /* along an axis */ };
enum { FAR_GUARDS = AROUND * AROUND * AROUND, GUARDS = FAR_GUARDS + WITHIN * WITHIN * WITHIN };
enum { FEW_WITHIN = 8, FEW_OUTSIDE = 16, VIEWS = 64 /* directions from a guard */ };
enum { TRIANGLES_AT_ONCE = 64 };
enum { NEAREST = 2 /* cells around a guard that are empty */ };
enum { AXES = 7, BINS = 32 /* along each side of the plane across one */ };
static const vec3 AXIS[AXES] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 1}, {-1, 1, 1}, {1, -1, 1}, {1, 1, -1}};
static const double ABOVE = 1;       /* cells: nearer to a place nothing hides it from those who are infinitely far */
static const double GRAZED = 0.25;   /* cosine to the normal: seen from the side nothing is clear */
static const double OFF_SURFACE = 2; /* cells */
static const double INNERMOST = 0.9, REACH = 2; /* of half the box */
static const double THIN = 0.15;                /* by its longest side, a box at least */
static const double WRONG = 0.1;                /* of the largest component seen, from its other side */
static const double ENCLOSED = 0.6;             /* of the directions from a room's first guard that meet something */
static const double MOST_ENCLOSED = 0.5;        /* the same from anywhere in its box, in the mean */
static const double NEARLY_ALL = 0.85, CLEARLY_MORE = 0.03; /* of the area: seen within, and than outside */
static const double MUCH_MORE = 0.12; /* likewise, of a room without a ceiling, whose first guard may stand above it */

/* A place of the mesh. */
struct piece {
    vec3 at, normal;
    uint32_t component;
};

struct watch {
    struct occupancy grid;
    size_t pieces;
    struct piece piece[LOOKED_AT];
    uint32_t largest; /* component, whose outer side is as its normals are, times outer */
    double outer;
    vec3 guard[GUARDS];
    bool stands[GUARDS];            /* nothing is in its way */
    double enclosed[GUARDS];        /* the share of directions in which there is something; of those in the box */
    int8_t seen[GUARDS][LOOKED_AT]; /* 1: from the front, -1: from the back */
    size_t first;                   /* guard that is looked from next */
    size_t piece_first, piece_step; /* pieces that are looked at next: that one, and every so many after it */
    size_t sides[GUARDS][2];        /* pieces of the largest component: outer, inner side */
};

/* Even in area. */
static void choose_pieces(const struct mesh *mesh, const uint32_t *component, double all, struct watch *w) {
    double area = 0;
    for (size_t t = 0; t < mesh->triangle_count && w->pieces < LOOKED_AT; t++) {
        const uint32_t *v = mesh->triangle[t];
        vec3 normal = mesh_triangle_normal(mesh, t);
        area += vec3_length(normal);
        if (area * LOOKED_AT < all * ((double)w->pieces + 0.5)) continue;
        vec3 sum = vec3_add(vec3_add(mesh->vertex[v[0]], mesh->vertex[v[1]]), mesh->vertex[v[2]]);
        const struct piece piece = {vec3_scale(sum, 1.0 / 3), vec3_unit(normal), component[t]};
        while (w->pieces < LOOKED_AT && area * LOOKED_AT >= all * ((double)w->pieces + 0.5))
            w->piece[w->pieces++] = piece;
    }
}

/* The largest component, and which way is out of it.  area: by component, zeroed.  Returns the area of all. */
static double find_largest(const struct mesh *mesh, const uint32_t *component, double *area, struct watch *w) {
    double all = 0, out = 0;
    vec3 middle = {0, 0, 0};
    for (size_t t = 0; t < mesh->triangle_count; t++) area[component[t]] += vec3_length(mesh_triangle_normal(mesh, t));
    for (uint32_t c = 0; c < mesh->triangle_count; c++) {
        all += area[c];
        if (area[c] > area[w->largest]) w->largest = c;
    }
    for (int round = 0; round < 2; round++)
        for (size_t t = 0; t < mesh->triangle_count; t++) {
            if (component[t] != w->largest) continue;
            vec3 normal = mesh_triangle_normal(mesh, t), at = mesh->vertex[mesh->triangle[t][0]];
            if (round == 0)
                middle = vec3_add(middle, vec3_scale(at, vec3_length(normal) / area[w->largest]));
            else
                out += vec3_dot(normal, vec3_sub(at, middle));
        }
    w->outer = out < 0 ? -1 : 1;
    return all;
}

/* ------------------------------------------------------------------------------------------- from infinitely far */

/* Pieces in the plane across an axis, by bins of it. */
struct outlook {
    vec3 side[2], up;
    double above; /* what hides a piece is farther along the axis than this */
    double low[2], high[2], bin[2];
    double at[LOOKED_AT][2], height[LOOKED_AT];
    uint16_t end[BINS * BINS + 1], piece[LOOKED_AT]; /* those of bin b: from end[b] to end[b + 1] */
    bool hidden[LOOKED_AT][2];                       /* from above, from below */
};

static size_t bin_along(const struct outlook *o, double at, int k) {
    double bin = (at - o->low[k]) * o->bin[k];
    return bin <= 0 ? 0 : bin >= BINS ? BINS - 1 : (size_t)bin;
}

static size_t bin_of(const struct outlook *o, const double at[2]) {
    return bin_along(o, at[1], 1) * BINS + bin_along(o, at[0], 0);
}

static void project_pieces(const struct watch *w, vec3 axis, struct outlook *o) {
    *o = (struct outlook){.up = vec3_unit(axis), .low = {INFINITY, INFINITY}, .high = {-INFINITY, -INFINITY}};
    vec3_basis(o->up, &o->side[0], &o->side[1]);
    for (size_t i = 0; i < w->pieces; i++) {
        o->height[i] = vec3_dot(w->piece[i].at, o->up);
        for (int k = 0; k < 2; k++) {
            double at = o->at[i][k] = vec3_dot(w->piece[i].at, o->side[k]);
            o->low[k] = fmin(o->low[k], at), o->high[k] = fmax(o->high[k], at);
        }
    }
    for (int k = 0; k < 2; k++) o->bin[k] = o->high[k] > o->low[k] ? BINS / (o->high[k] - o->low[k]) : 0;
    for (size_t i = 0; i < w->pieces; i++) o->end[bin_of(o, o->at[i]) + 1]++;
    for (size_t b = 0; b < BINS * BINS; b++) o->end[b + 1] = (uint16_t)(o->end[b + 1] + o->end[b]);
    for (size_t i = w->pieces; i-- > 0;) o->piece[--o->end[bin_of(o, o->at[i]) + 1]] = (uint16_t)i;
    memmove(o->end, o->end + 1, BINS * BINS * sizeof *o->end);
    o->end[BINS * BINS] = (uint16_t)w->pieces;
}

/* A triangle in that plane: corners, with heights over it, and the box of it. */
struct shadow {
    vec3 at[3], low, high;
};

/* vertex: in that plane. */
static void cast_shadow(const vec3 *vertex, const uint32_t corner[3], struct shadow *s) {
    for (int k = 0; k < 3; k++) s->at[k] = vertex[corner[k]];
    s->low = vec3_min(vec3_min(s->at[0], s->at[1]), s->at[2]);
    s->high = vec3_max(vec3_max(s->at[0], s->at[1]), s->at[2]);
}

/* Twice the area of a triangle in the plane. */
static double area_between(vec3 a, vec3 b, const double c[2]) {
    return (a.x - c[0]) * (b.y - c[1]) - (a.y - c[1]) * (b.x - c[0]);
}

/* Notes whether a triangle lies above or below a piece. */
static void hide_piece(struct outlook *o, const struct shadow *s, size_t i) {
    const double *at = o->at[i];
    if (at[0] < s->low.x || at[0] > s->high.x || at[1] < s->low.y || at[1] > s->high.y) return;
    double a = area_between(s->at[1], s->at[2], at), b = area_between(s->at[2], s->at[0], at);
    double c = area_between(s->at[0], s->at[1], at);
    bool covers = (a > 0 && b > 0 && c > 0) || (a < 0 && b < 0 && c < 0);
    if (!covers) return;
    double height = (a * s->at[0].z + b * s->at[1].z + c * s->at[2].z) / (a + b + c) - o->height[i];
    o->hidden[i][0] = o->hidden[i][0] || height > o->above;
    o->hidden[i][1] = o->hidden[i][1] || height < -o->above;
}

/* vertex: room for those of the mesh. */
static void hide_pieces(const struct mesh *mesh, struct outlook *o, vec3 *vertex) {
    struct shadow s;
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        vec3 p = mesh->vertex[v];
        vertex[v] = (vec3){vec3_dot(p, o->side[0]), vec3_dot(p, o->side[1]), vec3_dot(p, o->up)};
    }
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        cast_shadow(vertex, mesh->triangle[t], &s);
        size_t left = bin_along(o, s.low.x, 0), right = bin_along(o, s.high.x, 0), last = bin_along(o, s.high.y, 1);
        for (size_t row = bin_along(o, s.low.y, 1); row <= last; row++)
            for (size_t k = o->end[row * BINS + left]; k < o->end[row * BINS + right + 1]; k++)
                hide_piece(o, &s, o->piece[k]);
    }
}

static void note_seen(struct watch *w, size_t guard, size_t i, double along) {
    const struct piece *piece = &w->piece[i];
    w->seen[guard][i] = along < 0 ? -1 : 1;
    if (piece->component == w->largest) w->sides[guard][along * w->outer < 0]++;
}

/* Those who look along an axis from either end, as guards of these numbers. */
static void look_from_ends(struct watch *w, const struct outlook *o, size_t above, size_t below) {
    w->stands[above] = w->stands[below] = true;
    for (size_t i = 0; i < w->pieces; i++) {
        double along = vec3_dot(w->piece[i].normal, o->up);
        if (fabs(along) < GRAZED) continue;
        if (!o->hidden[i][0]) note_seen(w, above, i, along);
        if (!o->hidden[i][1]) note_seen(w, below, i, -along);
    }
}

/* ------------------------------------------------------------------------------------------------------- guards */

/* A grid of side^3 places. */
static void lay(vec3 middle, vec3 half, int side, vec3 *place) {
    for (int i = 0; i < side * side * side; i++) {
        vec3 at = {i % side, i / side % side, i / (side * side)};
        vec3 share = vec3_sub(vec3_scale(at, 2.0 / (side - 1)), (vec3){1, 1, 1});
        place[i] = vec3_add(middle, (vec3){share.x * half.x, share.y * half.y, share.z * half.z});
    }
}

static void place_guards(struct watch *w) {
    const struct occupancy *g = &w->grid;
    vec3 half = vec3_scale((vec3){g->count[0], g->count[1], g->count[2]}, g->cell / 2), middle = vec3_add(g->low, half);
    double most = fmax(half.x, fmax(half.y, half.z)), wide = REACH * most, thin = THIN * most;
    half = vec3_max(half, (vec3){thin, thin, thin});
    lay(middle, (vec3){wide, wide, wide}, AROUND, w->guard);
    lay(middle, vec3_scale(half, INNERMOST), WITHIN, &w->guard[FAR_GUARDS]);
}

static bool is_empty_around(const struct occupancy *g, vec3 at) {
    for (int z = -NEAREST; z <= NEAREST; z++)
        for (int y = -NEAREST; y <= NEAREST; y++)
            for (int x = -NEAREST; x <= NEAREST; x++) {
                vec3 beside = {at.x + x, at.y + y, at.z + z};
                ptrdiff_t cell = occupancy_at(g, beside);
                if (cell >= 0 && occupancy_held(g, beside, cell)) return false;
            }
    return true;
}

/* Whether nothing is between two places, in cells.  Who has left the grid doesn't come back. */
static bool is_in_sight(const struct occupancy *g, vec3 from, vec3 to) {
    vec3 way = vec3_sub(to, from), step = vec3_scale(vec3_unit(way), 0.5);
    int steps = (int)(2 * vec3_length(way));
    bool inside = false;
    for (int i = 0; i < steps;) {
        vec3 at = vec3_add(from, vec3_scale(step, i));
        ptrdiff_t cell = occupancy_at(g, at);
        if (cell >= 0 && occupancy_held(g, at, cell)) return false;
        if (cell < 0 && inside) return true;
        i += cell >= 0 ? occupancy_free_steps(g, at) : 1;
        inside = inside || cell >= 0;
    }
    return true;
}

/* The share of directions from a place in which there is something; they are equal steps of height, turned by the
 * golden angle. */
static double enclosed(const struct occupancy *g, vec3 place) {
    int met = 0;
    vec3 from = occupancy_in_cells(g, place);
    for (int i = 0; i < VIEWS; i++) {
        double z = 1 - (2 * i + 1.0) / VIEWS, angle = i * 2.399963229728653, r = sqrt(1 - z * z);
        met += !is_in_sight(g, from, vec3_add(from, vec3_scale((vec3){r * cos(angle), r * sin(angle), z}, 2 * CELLS)));
    }
    return (double)met / VIEWS;
}

/* Who stands where, and how enclosed those are who stand in the box. */
static void stand(void *ctx, size_t begin, size_t end) {
    struct watch *w = ctx;
    for (size_t k = w->first + begin; k < w->first + end; k++) {
        w->stands[k] = is_empty_around(&w->grid, occupancy_in_cells(&w->grid, w->guard[k]));
        if (w->stands[k] && k >= FAR_GUARDS) w->enclosed[k] = enclosed(&w->grid, w->guard[k]);
    }
}

/* From which side a guard sees a piece: 1 = the front, -1 = the back, 0 = neither. */
static int sees(const struct watch *w, size_t guard, const struct piece *piece) {
    const struct occupancy *g = &w->grid;
    double along = vec3_dot(vec3_unit(vec3_sub(w->guard[guard], piece->at)), piece->normal);
    if (fabs(along) < GRAZED) return 0;
    vec3 off = vec3_scale(piece->normal, along < 0 ? -OFF_SURFACE : OFF_SURFACE);
    vec3 from = vec3_add(occupancy_in_cells(g, piece->at), off);
    return !is_in_sight(g, from, occupancy_in_cells(g, w->guard[guard])) ? 0 : along < 0 ? -1 : 1;
}

static void look_around(void *ctx, size_t begin, size_t end) {
    struct watch *w = ctx;
    for (size_t k = w->first + begin; k < w->first + end; k++)
        for (size_t i = w->piece_first; i < w->pieces && w->stands[k]; i += w->piece_step) {
            int side = sees(w, k, &w->piece[i]);
            if (side) note_seen(w, k, i, side);
        }
}

/* Whether a guard's view of a piece counts on a side (1: outer, -1: inner) of the largest component. */
static bool is_watched(const struct watch *w, size_t guard, size_t piece, double side) {
    int8_t seen = w->seen[guard][piece];
    return seen && (w->piece[piece].component != w->largest || seen * w->outer * side > 0);
}

/* Who sees nothing of the largest component is within another one. */
static bool may_guard(const struct watch *w, size_t guard, double side) {
    size_t wrong = w->sides[guard][side > 0], right = w->sides[guard][side < 0];
    return w->stands[guard] && right > 0 && (double)wrong <= WRONG * (double)(wrong + right);
}

/* Up to `most` guards on a side that see as much as possible together; the share of pieces that they see. */
static double choose_guards(const struct watch *w, double side, size_t most, size_t *guard, size_t *count) {
    bool covered[LOOKED_AT] = {false};
    size_t all = 0;
    for (*count = 0; *count < most; ++*count) {
        size_t best = 0, gained = 0;
        for (size_t k = 0; k < GUARDS; k++) {
            size_t gain = 0;
            if (!may_guard(w, k, side)) continue;
            for (size_t i = 0; i < w->pieces; i++) gain += !covered[i] && is_watched(w, k, i, side);
            if (gain > gained) best = k, gained = gain;
        }
        if (gained == 0) break;
        for (size_t i = 0; i < w->pieces; i++) covered[i] = covered[i] || is_watched(w, best, i, side);
        guard[*count] = best, all += gained;
    }
    return (double)all / (double)w->pieces;
}

/* The box of pieces: of all, or of those of the largest component. */
static void find_box(const struct watch *w, bool largest, vec3 *low, vec3 *high) {
    *low = (vec3){INFINITY, INFINITY, INFINITY}, *high = (vec3){-INFINITY, -INFINITY, -INFINITY};
    for (size_t i = 0; i < w->pieces; i++)
        if (!largest || w->piece[i].component == w->largest)
            *low = vec3_min(*low, w->piece[i].at), *high = vec3_max(*high, w->piece[i].at);
}

/* The mean from guards in the box of the largest component: others may be what is seen through a window. */
static double all_enclosed(const struct watch *w) {
    vec3 low, high;
    double sum = 0;
    size_t count = 0;
    find_box(w, true, &low, &high);
    for (size_t k = FAR_GUARDS; k < GUARDS; k++) {
        vec3 at = w->guard[k];
        bool within = at.x > low.x && at.y > low.y && at.z > low.z && at.x < high.x && at.y < high.y && at.z < high.z;
        if (within && w->stands[k]) sum += w->enclosed[k], count++;
    }
    return count ? sum / (double)count : 0;
}

/* How components face those within who see them.  seen: scratch by component. */
static void find_facing(const struct watch *w, double *seen, double *facing) {
    for (size_t i = 0; i < w->pieces; i++) facing[w->piece[i].component] = seen[w->piece[i].component] = 0;
    for (size_t k = 0; k < GUARDS; k++)
        for (size_t i = 0; i < w->pieces && may_guard(w, k, -1); i++) {
            facing[w->piece[i].component] += w->seen[k][i];
            seen[w->piece[i].component] += abs(w->seen[k][i]);
        }
    for (size_t i = 0; i < w->pieces; i++) {
        double *of = &seen[w->piece[i].component];
        if (*of > 0) facing[w->piece[i].component] /= *of, *of = 0;
    }
}

/* Outlooks along some axes after each other: all of them may be more than are looked at, so these are few. */
enum { AT_ONCE = 2 };
struct outlooks {
    const struct watch *watch;
    const struct mesh *mesh;
    struct outlook *o; /* AT_ONCE */
    vec3 *vertex;      /* the mesh's in the plane of each, one after another */
    size_t first;      /* axis */
    double above;
};

static void look_along_axes(void *ctx, size_t begin, size_t end) {
    const struct outlooks *all = ctx;
    for (size_t k = begin; k < end; k++) {
        project_pieces(all->watch, AXIS[all->first + k], &all->o[k]);
        all->o[k].above = all->above;
        hide_pieces(all->mesh, &all->o[k], &all->vertex[k * all->mesh->vertex_count]);
    }
}

/* The share of pieces that those who look along axes see together, some of the axes if that is enough; afterwards
 * nobody has looked. */
static enum status see_from_afar(struct watch *w, const struct mesh *mesh, unsigned threads, double *share) {
    size_t at_once = threads == 1 ? 1 : AT_ONCE;
    struct outlooks looks = {.watch = w,
                             .mesh = mesh,
                             .o = alloc_array(at_once, sizeof *looks.o),
                             .vertex = alloc_array(at_once * mesh->vertex_count, sizeof *looks.vertex)};
    bool covered[LOOKED_AT] = {false};
    size_t all = 0;
    vec3 low, high;
    find_box(w, false, &low, &high);
    vec3 extent = vec3_sub(high, low);
    looks.above = ABOVE * fmax(extent.x, fmax(extent.y, extent.z)) / CELLS;
    *share = 0;
    bool enough = looks.o && looks.vertex;
    for (size_t a = 0; a < AXES && enough && *share + CLEARLY_MORE <= 1; a++) {
        if (a % at_once == 0) {
            looks.first = a;
            par_for(threads, a + at_once < AXES ? at_once : AXES - a, 1, look_along_axes, &looks);
        }
        look_from_ends(w, &looks.o[a % at_once], 2 * a, 2 * a + 1);
        for (size_t k = 2 * a; k < 2 * a + 2; k++)
            for (size_t i = 0; i < w->pieces && may_guard(w, k, 1); i++) {
                bool news = !covered[i] && is_watched(w, k, i, 1);
                covered[i] = covered[i] || news, all += news;
            }
        *share = (double)all / (double)w->pieces;
    }
    free(looks.o), free(looks.vertex);
    memset(w->seen, 0, sizeof w->seen), memset(w->sides, 0, sizeof w->sides), memset(w->stands, 0, sizeof w->stands);
    return enough ? STATUS_OK : STATUS_NO_MEMORY;
}

/* Guards that stand far off see most of a solid, and most of a room's box is enclosed: else others aren't asked. */
static void watch(struct watch *w, unsigned threads, struct gallery *gallery, double *scratch, double *facing) {
    size_t guard[FEW_OUTSIDE], count;
    place_guards(w);
    par_for(threads, FAR_GUARDS, 1, stand, w);
    par_for(threads, FAR_GUARDS, 1, look_around, w);
    gallery->outside = choose_guards(w, 1, FEW_OUTSIDE, guard, &count);
    if (gallery->outside + CLEARLY_MORE > 1) return;
    w->first = FAR_GUARDS;
    par_for(threads, GUARDS - FAR_GUARDS, 1, stand, w);
    if (all_enclosed(w) <= MOST_ENCLOSED) return;
    par_for(threads, GUARDS - FAR_GUARDS, 1, look_around, w);
    gallery->outside = choose_guards(w, 1, FEW_OUTSIDE, guard, &count);
    gallery->within = choose_guards(w, -1, FEW_WITHIN, guard, &count);
    double more = gallery->within - gallery->outside;
    gallery->room =
        gallery->within > NEARLY_ALL && (more > MUCH_MORE || (more > CLEARLY_MORE && w->enclosed[guard[0]] > ENCLOSED));
    if (facing) find_facing(w, scratch, facing);
}

/* Makes *w of a mesh, with pieces and, where those who look along axes don't see nearly all of them, with the grid;
 * then *open.  area: by component, zeroed. */
static enum status watch_new(const struct mesh *mesh, const uint32_t *component, unsigned threads, double *area,
                             struct watch **w, double *outside, bool *open) {
    *w = alloc_zeroed(1, sizeof **w);
    *outside = 0, *open = false;
    if (!*w) return STATUS_NO_MEMORY;
    (*w)->piece_step = 1;
    choose_pieces(mesh, component, find_largest(mesh, component, area, *w), *w);
    if ((*w)->pieces == 0) return STATUS_OK;
    enum status status = see_from_afar(*w, mesh, threads, outside);
    if (status || *outside + CLEARLY_MORE > 1) return status;
    status = occupancy_init(&(*w)->grid, mesh, NULL, CELLS, threads);
    *open = !status && !occupancy_is_empty(&(*w)->grid);
    return status;
}

static void watch_free(struct watch *w) {
    if (w) occupancy_done(&w->grid);
    free(w);
}

enum status gallery_find(const struct mesh *mesh, const uint32_t *component, unsigned threads, struct gallery *gallery,
                         double *facing) {
    struct watch *w = NULL;
    double *area = alloc_zeroed(mesh->triangle_count, sizeof *area);
    bool open = false;
    *gallery = (struct gallery){0};
    enum status status =
        area ? watch_new(mesh, component, threads, area, &w, &gallery->outside, &open) : STATUS_NO_MEMORY;
    if (open) watch(w, threads, gallery, area, facing);
    watch_free(w), free(area);
    return status;
}

/* Triangles that guards within look at. */
struct sides {
    const struct watch *watch;
    const struct mesh *mesh;
    size_t guard[FEW_WITHIN], count;
    double *side;
};

/* Up to FEW_WITHIN guards, as enclosed as a room's, who see as many pieces as possible, from either side. */
static void choose_within(const struct watch *w, struct sides *sides) {
    bool covered[LOOKED_AT] = {false};
    sides->count = 0;
    for (size_t gained = 1; sides->count < FEW_WITHIN && gained > 0;) {
        size_t best = gained = 0;
        for (size_t k = FAR_GUARDS; k < GUARDS; k++) {
            size_t gain = 0;
            if (!w->stands[k] || w->enclosed[k] <= ENCLOSED) continue;
            for (size_t i = 0; i < w->pieces; i++) gain += !covered[i] && w->seen[k][i];
            if (gain > gained) best = k, gained = gain;
        }
        for (size_t i = 0; i < w->pieces; i++) covered[i] = covered[i] || w->seen[best][i];
        if (gained > 0) sides->guard[sides->count++] = best;
    }
}

static void look_at_triangles(void *ctx, size_t begin, size_t end) {
    const struct sides *s = ctx;
    const struct watch *w = s->watch;
    for (size_t t = begin; t < end; t++) {
        const uint32_t *v = s->mesh->triangle[t];
        const vec3 *p = s->mesh->vertex;
        vec3 at = vec3_scale(vec3_add(vec3_add(p[v[0]], p[v[1]]), p[v[2]]), 1.0 / 3);
        const struct piece piece = {at, vec3_unit(mesh_triangle_normal(s->mesh, t)), 0};
        int sum = 0, seen = 0;
        for (size_t k = 0; k < s->count; k++) {
            int side = sees(w, s->guard[k], &piece);
            sum += side, seen += abs(side);
        }
        s->side[t] = seen ? (double)sum / seen : 0;
    }
}

/* The lesser of what was seen from either side, of both. */
static double lesser_share(double front, double back) {
    return front + back > 0 ? fmin(front, back) / (front + back) : 0;
}

/* Whether hardly any of the largest component is seen from the side that is less, by the pieces that were looked at: a
 * tenth would have that of some hundred as good as never. */
static bool hardly_turned(const struct sides *s) {
    static const double HARDLY = 0.02, ENOUGH = 64;
    const struct watch *w = s->watch;
    double front = 0, back = 0;
    for (size_t i = 0; i < w->pieces; i++) {
        int sum = 0, seen = 0;
        if (w->piece[i].component != w->largest) continue;
        for (size_t k = 0; k < s->count; k++) {
            int side = w->seen[s->guard[k]][i];
            sum += side, seen += abs(side);
        }
        if (seen) *(sum > 0 ? &front : &back) += (double)abs(sum) / seen;
    }
    return front + back > ENOUGH && lesser_share(front, back) < HARDLY;
}

/* Of what is seen of the largest component, by area, the share from the side that is less. */
static double turned_share(const struct sides *s, const uint32_t *component) {
    double front = 0, back = 0;
    for (size_t t = 0; t < s->mesh->triangle_count; t++) {
        if (component[t] != s->watch->largest) continue;
        double seen = s->side[t] * vec3_length(mesh_triangle_normal(s->mesh, t));
        *(seen > 0 ? &front : &back) += fabs(seen);
    }
    return lesser_share(front, back);
}

/* Who sees what of some pieces, and who of them look at triangles: nobody, where of few pieces hardly any is seen from
 * the other side. */
static void look_from_within_box(struct watch *w, unsigned threads, struct sides *sides) {
    enum { FEWER = 4 };
    w->piece_step = FEWER;
    for (w->piece_first = 0; w->piece_first < FEWER; w->piece_first++) {
        par_for(threads, GUARDS - FAR_GUARDS, 1, look_around, w);
        if (w->piece_first > 0) continue;
        choose_within(w, sides);
        if (hardly_turned(sides)) {
            sides->count = 0;
            return;
        }
    }
    choose_within(w, sides);
}

enum status gallery_sides(const struct mesh *mesh, const uint32_t *component, unsigned threads, double *side,
                          double *turned) {
    struct watch *w = NULL;
    double *area = alloc_zeroed(mesh->triangle_count, sizeof *area), outside;
    bool open = false;
    enum status status = area ? watch_new(mesh, component, threads, area, &w, &outside, &open) : STATUS_NO_MEMORY;
    struct sides sides = {.watch = w, .mesh = mesh, .side = side};
    *turned = 0;
    if (open) {
        place_guards(w);
        w->first = FAR_GUARDS;
        par_for(threads, GUARDS - FAR_GUARDS, 1, stand, w);
        if (all_enclosed(w) > MOST_ENCLOSED) look_from_within_box(w, threads, &sides);
    }
    if (sides.count > 0) {
        par_for(threads, mesh->triangle_count, TRIANGLES_AT_ONCE, look_at_triangles, &sides);
        *turned = turned_share(&sides, component);
    }
    watch_free(w), free(area);
    return status;
}
