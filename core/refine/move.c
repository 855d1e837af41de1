/* Where a vertex should be: Gauss-Newton on its star.
 *
 * A point's nearest place on the star is a blend of the corners in which the vertex has the share b; when the vertex
 * moves by s, its distance changes by -b s along the direction to the point, to first order.  The squares of all that
 * make a quadric of the vertex, whose minimum is the move.  Distances count as such rather than as squares, so each
 * square is divided by the distance as it is now (iteratively reweighted least squares).
 *
 * Optimal placement takes the minimum, or a part of the way; subset placement takes the one of the star's points where
 * the quadric is smallest.  Both only when the star then costs less, measured anew, and nothing folds.  On a border a
 * vertex moves along its normal or to a point: nothing else keeps the border from running off.
 *
 * Two vertices are near each other where they share a star, or a triangle that either looks at.  Those that are near
 * none of another part are moved part by part, which are in parallel; then those along the borders of parts, coloured
 * so that no two of a colour are near each other, colour by colour, each in parallel.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/refine_internal.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/math/sym3.h"
#include "core/refine/prefetch.h"

enum { VERTEX_GRAIN = 16, STANDING_GRAIN = 512, COLOURS = 64, CANDIDATES = 3 };

/* What a star is made of is fetched while other vertices are tried: first a triangle; then the ring, which is kept
 * until the vertex moves, and with it most of what the star takes; then the second and third block of each list of
 * samples. */
enum { TRIANGLE_AHEAD = 8, STAR_AHEAD = 4, SECOND_AHEAD = 2, THIRD_AHEAD = 1, RINGS = 2 * STAR_AHEAD };

#define MOVE_LEAST_GAIN 1e-3 /* of what the star costs */
#define MOVE_HOPELESS 1.5    /* of what the star costs: where the first choice is over that, the others are no better */
#define MOVE_STAY 1e-4       /* pull towards the present place, of the quadric's trace */

static const struct star_limits limits_of_moves = {.turn = 0.5f, .thin = (float)FIT_THIN};

struct ring {
    size_t n;
    uint32_t out[FIT_MAX_RING]; /* half-edges out of the vertex */
};

struct star {
    uint32_t vertex;
    size_t n;
    const uint32_t *ring; /* half-edges out of the vertex */
    struct fit_region region;
    struct star_rim rim;
    struct star_frames old, new;
    struct star_vectors outside; /* normals across the rim */
    double cost;
};

_Static_assert((int)FIT_MAX_RING <= (int)STAR_MOST, "stars have frames");

static vec3 rim_place(const struct fit *fit, const struct star *star, size_t i) {
    return fit->mesh->vertex[fit_rim_vertex(fit, star->ring, star->n, i)];
}

static void set_star_rim(const struct fit *fit, struct star *star) {
    static const vec3 none = {0};
    const vec3 *place[FIT_MAX_RING], *normal[FIT_MAX_RING];
    bool open = fit_is_on_border(fit, star->vertex);
    for (size_t i = 0; i < star->n; i++) {
        uint32_t across = fit->he.twin[halfedge_next(star->ring[i])];
        normal[i] = across == NONE ? &none : &fit->facing[across / 3].normal;
    }
    for (size_t i = 0; i < star->n + open; i++)
        place[i] = &fit->mesh->vertex[fit_rim_vertex(fit, star->ring, star->n, i)];
    star->rim.n = star->n;
    star->rim.open = open;
    star_vectors_set(&star->rim.place, place, star->n + open, star->region.batch.origin);
    star_vectors_set(&star->outside, normal, star->n, none);
}

static void set_star_frames(const struct star *star, vec3 place, struct star_frames *frames) {
    star_frames_make(frames, &star->rim, vec3_sub(place, star->region.batch.origin));
}

static bool star_of(const struct fit *fit, uint32_t vertex, const struct ring *ring, struct star *star) {
    star->vertex = vertex;
    star->n = ring->n;
    star->ring = ring->out;
    star->cost = 0;
    if (star->n < (fit_is_on_border(fit, vertex) ? 1 : 3)) return false;
    for (size_t i = 0; i < star->n; i++) {
        star->region.triangle[i] = star->ring[i] / 3;
        star->cost += fit->cost[star->ring[i] / 3];
    }
    star->region.n = star->n;
    fit_gather(fit, &star->region);
    set_star_rim(fit, star);
    set_star_frames(star, fit->mesh->vertex[vertex], &star->old);
    return true;
}

static void fetch_star(const struct fit *fit, uint32_t vertex, struct ring *ring) {
    ring->n = fit_ring(fit, vertex, ring->out);
    for (size_t i = 0; i < ring->n; i++) {
        uint32_t t = ring->out[i] / 3, across = fit->he.twin[halfedge_next(ring->out[i])];
        prefetch(&fit->mesh->vertex[halfedge_to(&fit->he, ring->out[i])]);
        prefetch(&fit->cost[t]);
        if (across != NONE) prefetch(&fit->facing[across / 3]);
        sample_buckets_fetch(&fit->lists, fit->lists.first[t]);
    }
}

/* Block number `at` of each list of samples; those before it are there. */
static void fetch_block(const struct fit *fit, const struct ring *ring, size_t at) {
    for (size_t i = 0; i < ring->n; i++) {
        uint32_t block = fit->lists.first[ring->out[i] / 3];
        for (size_t k = 0; k < at && block != NONE; k++) block = fit->lists.block[block].next;
        sample_buckets_fetch(&fit->lists, block);
    }
}

/* The s where the model is smallest; zero where it says nothing. */
static vec3 model_minimum(const struct sample_batch_model *model) {
    sym3 a = model->a;
    double stay = MOVE_STAY * sym3_trace(a);
    a.xx += stay, a.yy += stay, a.zz += stay;
    vec3 r0 = {a.xx, a.xy, a.xz}, r1 = {a.xy, a.yy, a.yz}, r2 = {a.xz, a.yz, a.zz};
    vec3 c0 = vec3_cross(r1, r2), c1 = vec3_cross(r2, r0), c2 = vec3_cross(r0, r1);
    double det = vec3_dot(r0, c0);
    if (!(det > 0)) return (vec3){0};
    vec3 s = {vec3_dot(c0, model->g), vec3_dot(c1, model->g), vec3_dot(c2, model->g)};
    s = vec3_scale(s, 1 / det);
    return vec3_is_finite(s) ? s : (vec3){0};
}

static bool star_stays(const struct fit *fit, const struct star *star, vec3 place) {
    vec3 middle[FIT_MAX_RING];
    for (size_t i = 0; i < star->n; i++) {
        vec3 rim = vec3_add(rim_place(fit, star, i), rim_place(fit, star, i + 1));
        middle[i] = vec3_scale(vec3_add(place, rim), 1.0 / 3);
    }
    return fit->borders ? fit_middles_stay(fit, &star->region, middle, star->n)
                        : fit_star_stays(fit, &star->region, middle, fit->mesh->vertex[star->vertex], place);
}

/* The star's cost with the vertex at place, or INFINITY when that isn't fair.  What isn't under limit is known less
 * well, and not looked at any further, but it is known whether it is over `most` (at least limit). */
static double relocated_cost(const struct fit *fit, struct star *star, vec3 place, double limit, double most) {
    set_star_frames(star, place, &star->new);
    if (!star_may_become(&star->old, &star->new, &star->outside, fit_limits(fit, limits_of_moves))) return INFINITY;
    if (!fit_star_faces_front(fit, &star->new, place)) return INFINITY;
    double cost = fit_star_cost(fit, &star->region, &star->new, most);
    return cost >= limit || star_stays(fit, star, place) ? cost : INFINITY;
}

static void put_vertex(struct fit *fit, uint32_t vertex, const struct fit_region *star, vec3 place, uint32_t source) {
    fit->mesh->vertex[vertex] = place;
    if (fit->mesh->source) fit->mesh->source[vertex] = source;
    fit_share(fit, star->triangle, star->n, star->triangle, star->n);
}

static bool move_freely(struct fit *fit, struct star *star, vec3 step) {
    static const double part[] = {1.4, 0.7, 0.25};
    vec3 from = fit->mesh->vertex[star->vertex];
    double limit = star->cost * (1 - MOVE_LEAST_GAIN);
    for (size_t i = 0; i < sizeof part / sizeof *part; i++) {
        vec3 place = vec3_add(from, vec3_scale(step, part[i]));
        if (relocated_cost(fit, star, place, limit, limit) >= limit) continue;
        put_vertex(fit, star->vertex, &star->region, place, NONE);
        return true;
    }
    return false;
}

struct choice {
    float value;
    uint32_t point;
};

/* Puts the points of a batch among the choices as far as they are better; the number of choices. */
static size_t choose_among(const struct fit *fit, const struct sample_batch *batch, const float *value,
                           struct choice choice[CANDIDATES], size_t count) {
    float worst = count < CANDIDATES ? INFINITY : choice[count - 1].value;
    for (size_t i = 0; i < batch->n; i++) {
        if (!(value[i] < worst)) continue;
        uint32_t point = batch->sample[i];
        if (fit->taken[point]) continue;
        size_t at = count < CANDIDATES ? count++ : count - 1;
        for (; at > 0 && choice[at - 1].value > value[i]; at--) choice[at] = choice[at - 1];
        choice[at] = (struct choice){value[i], point};
        prefetch(&fit->input->points[point]);
        if (count == CANDIDATES) worst = choice[count - 1].value;
    }
    return count;
}

/* The points of the star where the model is smallest, best first; their number. */
static size_t choose(const struct fit *fit, const struct star *star, const struct sample_batch_model *model, vec3 step,
                     struct choice choice[CANDIDATES]) {
    vec3 target = vec3_add(fit->mesh->vertex[star->vertex], step);
    sym3 a = model->a;
    double stay = MOVE_STAY * sym3_trace(a);
    a.xx += stay, a.yy += stay, a.zz += stay;
    size_t count = 0;
    struct fit_region more;
    float value[SAMPLE_BATCH_ROOM];
    for (const struct fit_region *part = &star->region; part; part = fit_next_part(fit, part, &more)) {
        sample_batch_values(&part->batch, &a, target, fit->samples.points, value);
        count = choose_among(fit, &part->batch, value, choice, count);
    }
    return count;
}

static bool move_to_point(struct fit *fit, struct star *star, const struct sample_batch_model *model, vec3 step) {
    struct choice choice[CANDIDATES];
    size_t count = choose(fit, star, model, step, choice);
    double limit = star->cost * (1 - MOVE_LEAST_GAIN);
    double hopeless = MOVE_HOPELESS * star->cost;
    uint32_t best = NONE;
    for (size_t i = 0; i < count; i++) {
        double cost = relocated_cost(fit, star, fit->input->points[choice[i].point], limit, i == 0 ? hopeless : limit);
        if (cost < limit) limit = cost, best = choice[i].point;
        if (i == 0 && cost < INFINITY && cost > hopeless) break;
    }
    if (best == NONE) return false;
    fit_take(fit, best);
    put_vertex(fit, star->vertex, &star->region, fit->input->points[best], best);
    return true;
}

/* The part of a step that leaves a border where it is. */
static vec3 along_normal(const struct star *star, vec3 step) {
    vec3 sum = {0};
    for (size_t i = 0; i < star->n; i++) sum = vec3_add(sum, star_vectors_at(&star->old.normal, i));
    vec3 normal = vec3_unit(sum);
    return vec3_scale(normal, vec3_dot(normal, step));
}

static bool move_vertex(struct fit *fit, uint32_t vertex, const struct ring *ring) {
    struct star star;
    if (!star_of(fit, vertex, ring, &star)) return false;
    if (fit_is_exact(sample_batch_weight(&star.region.batch), star.cost)) return false;
    struct sample_batch_model model = fit_model(fit, &star.region, &star.old, fit->near);
    vec3 step = model_minimum(&model);
    if (fit->placement == PLACEMENT_SUBSET) return move_to_point(fit, &star, &model, step);
    if (!star.rim.open) return move_freely(fit, &star, step);
    return move_freely(fit, &star, along_normal(&star, step)) || move_to_point(fit, &star, &model, step);
}

double fit_move_cost(const struct fit *fit, uint32_t vertex, vec3 place, enum fit_fairness fairness) {
    struct ring ring;
    struct star star;
    struct star_limits turning = fit_limits(fit, limits_of_moves);
    turning.turn = -1;
    ring.n = fit_ring(fit, vertex, ring.out);
    if (!star_of(fit, vertex, &ring, &star)) return INFINITY;
    if (fairness == FIT_FAIR) return relocated_cost(fit, &star, place, INFINITY, INFINITY) - star.cost;
    set_star_frames(&star, place, &star.new);
    if (fairness == FIT_TURNING && !star_may_become(&star.old, &star.new, &star.outside, turning)) return INFINITY;
    if (!fit_star_faces_front(fit, &star.new, place)) return INFINITY;
    if (fairness == FIT_TURNING && !star_stays(fit, &star, place)) return INFINITY;
    return fit_star_cost(fit, &star.region, &star.new, INFINITY) - star.cost;
}

void fit_move_one(struct fit *fit, uint32_t vertex, vec3 place, uint32_t source) {
    struct fit_region star;
    uint32_t ring[FIT_MAX_RING];
    star.n = fit_ring(fit, vertex, ring);
    for (size_t i = 0; i < star.n; i++) star.triangle[i] = ring[i] / 3;
    put_vertex(fit, vertex, &star, place, source);
}

/* The vertices that are near this one; their number, or 0 where there are more than fit. */
static size_t find_near(const struct fit *fit, uint32_t vertex, uint32_t near[2 * FIT_MAX_RING]) {
    const struct halfedge *he = &fit->he;
    uint32_t ring[FIT_MAX_RING];
    size_t n = fit_ring(fit, vertex, ring), count = 0;
    for (size_t i = 0; i < n; i++) {
        uint32_t across = he->twin[halfedge_next(ring[i])];
        near[count++] = halfedge_to(he, ring[i]);
        if (across != NONE) near[count++] = halfedge_apex(he, across);
    }
    if (n > 0 && fit_is_on_border(fit, vertex)) near[count++] = halfedge_apex(he, ring[n - 1]);
    return count;
}

/* In which order vertices are moved: group by group.  Each part is a group, and after them each colour. */
struct plan {
    const struct fit *fit;
    uint8_t *standing; /* of each vertex that is due: enum standing */
    uint32_t *group;   /* of each vertex, or NONE for those that aren't due */
    uint32_t *vertex;
    size_t *start; /* vertex[start[g] .. start[g + 1]) are those of group g */
    size_t parts, groups;
};

enum standing { WITHIN_PART, BETWEEN_PARTS, TOO_MANY_NEAR };

/* Within its part where no vertex near this one is due in another. */
static enum standing standing_of(const struct plan *plan, uint32_t vertex) {
    uint32_t near[2 * FIT_MAX_RING];
    size_t n = find_near(plan->fit, vertex, near);
    if (n == 0) return TOO_MANY_NEAR;
    for (size_t i = 0; i < n; i++)
        if (plan->group[near[i]] != NONE && plan->group[near[i]] != plan->group[vertex]) return BETWEEN_PARTS;
    return WITHIN_PART;
}

static void find_standings(void *ctx, size_t begin, size_t end) {
    const struct plan *plan = ctx;
    for (size_t v = begin; v < end; v++)
        if (plan->group[v] != NONE) plan->standing[v] = (uint8_t)standing_of(plan, (uint32_t)v);
}

/* The lowest colour that no vertex near this one has. */
static uint32_t free_colour(const struct plan *plan, const uint32_t *near, size_t n) {
    uint64_t used = 0;
    for (size_t i = 0; i < n; i++) {
        size_t colour = plan->group[near[i]] - plan->parts;
        if (plan->group[near[i]] != NONE && colour < COLOURS) used |= (uint64_t)1 << colour;
    }
    return used == UINT64_MAX ? NONE : (uint32_t)(plan->parts + (size_t)__builtin_ctzll(~used));
}

/* Only what is stale is going to move. */
static void find_groups(const struct fit *fit, struct plan *plan) {
    uint32_t near[2 * FIT_MAX_RING], *group = plan->group;
    for (uint32_t v = 0; v < fit->mesh->vertex_count; v++) {
        bool due = fit->stale[v] && fit->he.locked[v] != HALFEDGE_KNOTTED && fit->he.out[v] != NONE;
        group[v] = due ? fit->partition.of[v] : NONE;
    }
    par_for(fit->threads, fit->mesh->vertex_count, STANDING_GRAIN, find_standings, plan);
    for (uint32_t v = 0; v < fit->mesh->vertex_count; v++) {
        if (group[v] == NONE || plan->standing[v] == WITHIN_PART) continue;
        group[v] = plan->standing[v] == BETWEEN_PARTS ? free_colour(plan, near, find_near(fit, v, near)) : NONE;
    }
}

static void sort_by_group(const struct plan *plan, size_t n) {
    size_t *start = plan->start;
    for (size_t v = 0; v < n; v++)
        if (plan->group[v] != NONE) start[plan->group[v] + 2]++;
    for (size_t g = 2; g < plan->groups + 2; g++) start[g] += start[g - 1];
    for (uint32_t v = 0; v < n; v++)
        if (plan->group[v] != NONE) plan->vertex[start[plan->group[v] + 1]++] = v;
}

static enum status plan_new(const struct fit *fit, struct plan *plan) {
    size_t n = fit->mesh->vertex_count;
    *plan = (struct plan){.fit = fit, .parts = fit->partition.count, .groups = fit->partition.count + COLOURS};
    plan->standing = alloc_array(n, 1);
    plan->group = alloc_array(n, sizeof *plan->group);
    plan->vertex = alloc_array(n, sizeof *plan->vertex);
    plan->start = alloc_zeroed(plan->groups + 2, sizeof *plan->start);
    if (!plan->standing || !plan->group || !plan->vertex || !plan->start) return STATUS_NO_MEMORY;
    find_groups(fit, plan);
    sort_by_group(plan, n);
    return STATUS_OK;
}

struct batch {
    struct fit *fit;
    const struct plan *plan;
    uint32_t *left; /* the points that vertices left, or NONE */
    uint8_t *moved;
    size_t begin; /* of the vertices that are moved in parallel, where each is a range of its own */
};

/* Vertices that are moved one after the other, with the rings of the next ones. */
struct moving {
    const struct batch *batch;
    struct ring ring[RINGS];
};

static void fetch_one_triangle(void *ctx, size_t i) {
    const struct moving *moving = ctx;
    const struct fit *fit = moving->batch->fit;
    fit_fetch_links(fit, fit->he.out[moving->batch->plan->vertex[i]] / 3);
}

static void fetch_ring(void *ctx, size_t i) {
    struct moving *moving = ctx;
    fetch_star(moving->batch->fit, moving->batch->plan->vertex[i], &moving->ring[i % RINGS]);
}

static void fetch_second_blocks(void *ctx, size_t i) {
    const struct moving *moving = ctx;
    fetch_block(moving->batch->fit, &moving->ring[i % RINGS], 1);
}

static void fetch_third_blocks(void *ctx, size_t i) {
    const struct moving *moving = ctx;
    fetch_block(moving->batch->fit, &moving->ring[i % RINGS], 2);
}

static bool move_next(void *ctx, size_t i) {
    const struct moving *moving = ctx;
    const struct batch *batch = moving->batch;
    uint32_t v = batch->plan->vertex[i], *source = batch->fit->mesh->source;
    uint32_t before = source ? source[v] : NONE;
    batch->moved[i] = move_vertex(batch->fit, v, &moving->ring[i % RINGS]);
    batch->left[i] = batch->moved[i] ? before : NONE;
    return true;
}

static void move_range(const struct batch *batch, size_t begin, size_t end) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {{TRIANGLE_AHEAD, fetch_one_triangle},
                                                           {STAR_AHEAD, fetch_ring},
                                                           {SECOND_AHEAD, fetch_second_blocks},
                                                           {THIRD_AHEAD, fetch_third_blocks}};
    struct moving moving;
    moving.batch = batch;
    for_each_prefetched(ahead, &moving, begin, end, move_next);
}

static void move_parts(void *ctx, size_t begin, size_t end) {
    const struct batch *batch = ctx;
    move_range(batch, batch->plan->start[begin], batch->plan->start[end]);
}

static void move_colour(void *ctx, size_t begin, size_t end) {
    const struct batch *batch = ctx;
    move_range(batch, batch->begin + begin, batch->begin + end);
}

/* The star has changed, and so have those of the neighbours. */
static void mark_moved(struct fit *fit, uint32_t vertex) {
    uint32_t ring[FIT_MAX_RING];
    size_t n = fit_ring(fit, vertex, ring);
    for (size_t i = 0; i < n; i++) {
        fit->touched[ring[i] / 3] = 1;
        fit->stale[halfedge_to(&fit->he, ring[i])] = 1;
        fit->stale[halfedge_apex(&fit->he, ring[i])] = 1;
    }
    fit->stale[vertex] = 1;
}

/* Tells what has become of vertices after they were tried, in the same order; how many moved.  Points that they left
 * become free only now, so that what a vertex may take doesn't depend on threads. */
static size_t conclude(const struct batch *batch, size_t begin, size_t end) {
    size_t moves = 0;
    for (size_t i = begin; i < end; i++) {
        uint32_t v = batch->plan->vertex[i];
        moves += batch->moved[i];
        batch->fit->stale[v] = 0;
        if (batch->moved[i]) mark_moved(batch->fit, v);
        fit_leave(batch->fit, batch->left[i]);
    }
    return moves;
}

static size_t move_groups(struct batch *batch) {
    const struct plan *plan = batch->plan;
    par_for(batch->fit->threads, plan->parts, 1, move_parts, batch);
    size_t moves = conclude(batch, 0, plan->start[plan->parts]);
    for (size_t g = plan->parts; g < plan->groups; g++) {
        batch->begin = plan->start[g];
        par_for(batch->fit->threads, plan->start[g + 1] - plan->start[g], VERTEX_GRAIN, move_colour, batch);
        moves += conclude(batch, plan->start[g], plan->start[g + 1]);
    }
    return moves;
}

enum status fit_move(struct fit *fit, size_t *moves) {
    struct plan plan;
    size_t n = fit->mesh->vertex_count;
    uint8_t *moved = alloc_array(n, 1);
    uint32_t *left = alloc_array(n, sizeof *left);
    enum status status = plan_new(fit, &plan);
    if (!moved || !left) status = STATUS_NO_MEMORY;
    if (status == STATUS_OK) *moves += move_groups(&(struct batch){fit, &plan, left, moved, 0});
    free(plan.standing), free(plan.group), free(plan.vertex), free(plan.start);
    free(moved), free(left);
    return status;
}
