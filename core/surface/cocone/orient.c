/* Orientation by gathered evidence.
 *
 * A normal is a line until it is known which end points out.  A cell is in or out, as a whole; so it is evidence on the
 * normals of any two of its vertices: if it lies above the one and below the other, one of the two has to be turned.
 * The infinite cells are out: they tie their vertices to one node more, OUT.
 *
 *     vertex ---(sum over the common cells of the product of their lies)--- vertex ... OUT
 *
 * Links with a positive sum keep two normals as they are to each other, negative ones turn one of them.  Clusters of
 * nodes are joined round by round, first where the evidence is strongest; then links between the same two clusters are
 * added up, so that a few wrong ones, as at sharp edges and through thin sheets, are outvoted by the others between the
 * same two patches before they are believed.
 *
 * How a cell lies to its vertex is the geometric mean of two cosines with the normal, the dual's (circumcentre) and the
 * cell's own (centroid), where their signs agree, else next to nothing: a long cell that stands on the surface is
 * certain, a flat one that lies in it isn't, and neither is one that pokes through a thin sheet.
 *
 * Invariant: each round joins the strongest link of all at least, and ties go by the order of the links, so the loop
 * ends and the result is a function of the arrays alone.
 *
 * Sources: R. Kolluri, J. Shewchuk, J. O'Brien, Spectral surface reconstruction from noisy point clouds (2004) ties
 * poles the same way; M. Keuper et al., Efficient decomposition of image and mesh graphs by lifted multicuts (2015)
 * join clusters along the strongest sum.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/disjoint_set.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"

enum { GRAIN = 2048 };

#define MEANS 1.0
#define CERTAIN 0.5
#define FAINT 1e-4    /* of a cell on whose side nothing certain can be said */
#define NEAR 4        /* supports: points of one piece are at most so far apart */
#define HULL_LIE 3.0f /* of an infinite cell to the vertex at infinity */

/* Evidence between two clusters, low < high; positive: as they are. */
struct link {
    uint32_t low, high;
    double weight;
};

/* A forest of nodes with parities: union by size, paths halved. */
struct disjoint_set {
    uint32_t *parent; /* of a root: itself */
    uint8_t *parity;  /* to the parent */
    uint32_t *size;
};

static uint32_t find(struct disjoint_set *disjoint_set, uint32_t node, uint8_t *parity) {
    uint8_t p = 0;
    while (disjoint_set->parent[node] != node) {
        uint32_t up = disjoint_set->parent[node];
        disjoint_set->parity[node] ^= disjoint_set->parity[up] & (uint8_t)(disjoint_set->parent[up] != up);
        disjoint_set->parent[node] = disjoint_set->parent[up];
        p ^= disjoint_set->parity[node];
        node = disjoint_set->parent[node];
    }
    *parity = p;
    return node;
}

static void join(struct disjoint_set *disjoint_set, uint32_t a, uint32_t b, uint8_t parity) {
    uint8_t to_a, to_b;
    uint32_t ra = find(disjoint_set, a, &to_a), rb = find(disjoint_set, b, &to_b);
    if (ra == rb) return;
    if (disjoint_set->size[ra] < disjoint_set->size[rb]) {
        uint32_t swap = ra;
        ra = rb;
        rb = swap;
    }
    disjoint_set->parent[rb] = ra;
    disjoint_set->parity[rb] = to_a ^ to_b ^ parity;
    disjoint_set->size[ra] += disjoint_set->size[rb];
}

/* ------------------------------------------------------------------------------------------------ lies */

struct measuring {
    const struct cocone_star *star;
    const struct cocone_frame *frame;
    struct cocone_lies *lies;
    int count;
};

static vec3 centroid_direction(const struct cocone_star *star, uint32_t cell, uint32_t vertex) {
    const uint32_t *v = star->tets->vertex[cell];
    vec3 sum = {0, 0, 0};
    for (int i = 0; i < 4; i++) sum = vec3_add(sum, vec3_sub(star->point[v[i]], star->point[vertex]));
    return vec3_unit(sum);
}

/* How a cell lies to its vertex i, in all frames: from the cosines of the normal with the directions of the dual and of
 * the cell itself. */
static void measure(const struct measuring *m, uint32_t cell, int i) {
    uint32_t vertex = m->star->tets->vertex[cell][i];
    vec3 dual = {0}, own = {0};
    if (vertex != NONE) dual = own = vec3_unit(cocone_star_dual(m->star, cell, vertex));
    if (cocone_star_is_finite(m->star, cell)) own = centroid_direction(m->star, cell, vertex);
    for (int k = 0; k < m->count; k++) {
        float lie = HULL_LIE;
        if (vertex != NONE) {
            vec3 normal = m->frame[k].normal[vertex];
            double to_dual = vec3_dot(dual, normal), to_own = vec3_dot(own, normal);
            double certainty = FAINT + sqrt(to_own * to_dual > 0 ? to_own * to_dual : 0);
            lie = (float)(to_dual < 0 ? -certainty : certainty);
        }
        m->lies[k].lie[cell][i] = lie;
    }
}

static void measure_range(void *ctx, size_t begin, size_t end) {
    for (uint32_t c = (uint32_t)begin; c < end; c++)
        for (int i = 0; i < 4; i++) measure(ctx, c, i);
}

enum status cocone_orient_measure(const struct cocone_star *star, const struct cocone_frame frame[], int count,
                                  unsigned threads, struct cocone_lies lies[]) {
    for (int k = 0; k < count; k++) {
        lies[k].lie = alloc_array(star->tets->cell_count, sizeof *lies->lie);
        if (!lies[k].lie) return STATUS_NO_MEMORY;
    }
    struct measuring m = {star, frame, lies, count};
    par_for(threads, star->tets->cell_count, GRAIN, measure_range, &m);
    return STATUS_OK;
}

void cocone_orient_done(struct cocone_lies *lies) {
    free(lies->lie);
    lies->lie = NULL;
}

/* ------------------------------------------------------------------------------------------------ links */

/* Adds up weights by a second id, for one first id at a time. */
struct sums {
    struct sum {
        double weight;
        uint32_t low; /* what it is a sum for; another id = none yet */
    } * sum;          /* of each id */
    uint32_t *ids;    /* those that have a sum */
    size_t count;
};

static inline void sums_add(struct sums *sums, uint32_t low, uint32_t id, double weight) {
    struct sum *sum = &sums->sum[id];
    if (sum->low != low) {
        *sum = (struct sum){0, low};
        sums->ids[sums->count++] = id;
    }
    sum->weight += weight;
}

/* Writes the sums as links of low, and forgets them. */
static size_t sums_flush(struct sums *sums, uint32_t low, struct link *link) {
    size_t count = sums->count;
    for (size_t i = 0; i < count; i++) {
        struct sum *sum = &sums->sum[sums->ids[i]];
        link[i] = (struct link){low, sums->ids[i], sum->weight};
        sum->low = NONE;
    }
    sums->count = 0;
    return count;
}

/* All links of vertices with vertices of larger id and with OUT, which is n. */
static size_t link_vertices(const struct cocone_star *star, const float (*lie)[4], struct sums *sums,
                            struct link *link) {
    size_t count = 0;
    for (uint32_t v = 0; v < star->n; v++) {
        for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++) {
            uint32_t cell = cocone_star_cell(star->corner[i]);
            double mine = (double)lie[cell][cocone_star_index(star->corner[i])];
            for (int k = 0; k < 4; k++) {
                uint32_t other = star->tets->vertex[cell][k];
                if (other > v)
                    sums_add(sums, v, other == NONE ? (uint32_t)star->n : other, mine * (double)lie[cell][k]);
            }
        }
        count += sums_flush(sums, v, link + count);
    }
    return count;
}

/* ------------------------------------------------------------------------------------------------ rounds */

struct cocone_gathering {
    size_t nodes, clusters;
    struct link *link, *next; /* between clusters; next: room for as many */
    size_t count;
    uint32_t *root; /* of each cluster: its node that is a root, ascending */
    struct best {
        double weight;
        uint32_t link; /* NONE = it has none */
    } * best;          /* of each cluster: its strongest link */
    struct merged {
        uint32_t into;
        uint8_t parity;
    } * merged;      /* of each cluster: which one it belongs to after a round */
    uint32_t *rank;  /* of each node that is a root: its cluster */
    uint32_t *begin; /* nodes + 1 */
    struct disjoint_set disjoint_set;
    struct sums sums;
};

/* Of equals the first link, as they come in order. */
static void consider(struct best *best, uint32_t i, double weight) {
    if (weight > best->weight || best->link == NONE) *best = (struct best){weight, i};
}

static void find_best(struct cocone_gathering *g) {
    for (size_t c = 0; c < g->clusters; c++) g->best[c] = (struct best){0, NONE};
    for (uint32_t i = 0; i < g->count; i++) {
        double weight = fabs(g->link[i].weight);
        consider(&g->best[g->link[i].low], i, weight);
        consider(&g->best[g->link[i].high], i, weight);
    }
}

/* What a link must weigh to be joined now: MEANS times the mean of all clusters' best ones, at most the strongest. */
static double least_weight(const struct cocone_gathering *g) {
    double sum = 0, strongest = 0;
    size_t count = 0;
    for (size_t c = 0; c < g->clusters; c++) {
        if (g->best[c].link == NONE) continue;
        sum += g->best[c].weight;
        strongest = g->best[c].weight > strongest ? g->best[c].weight : strongest;
        count++;
    }
    double mean = MEANS * sum / (double)count;
    return mean < strongest ? mean : strongest;
}

static void join_best(struct cocone_gathering *g, double least) {
    for (uint32_t i = 0; i < g->count; i++) {
        const struct link *link = &g->link[i];
        if (g->best[link->low].link != i && g->best[link->high].link != i) continue;
        if (fabs(link->weight) >= least)
            join(&g->disjoint_set, g->root[link->low], g->root[link->high], link->weight < 0);
    }
}

/* Numbers the clusters that are left, in the order of their roots. */
static void number_clusters(struct cocone_gathering *g) {
    size_t left = 0;
    for (size_t c = 0; c < g->clusters; c++)
        if (g->disjoint_set.parent[g->root[c]] == g->root[c]) g->rank[g->root[c]] = (uint32_t)left++;
    for (size_t c = 0; c < g->clusters; c++) {
        struct merged *merged = &g->merged[c];
        merged->into = g->rank[find(&g->disjoint_set, g->root[c], &merged->parity)];
    }
    left = 0;
    for (size_t c = 0; c < g->clusters; c++)
        if (g->disjoint_set.parent[g->root[c]] == g->root[c]) g->root[left++] = g->root[c];
    g->clusters = left;
}

/* A link after the clusters at its ends were joined to others; low == high where they are the same. */
static struct link moved(const struct cocone_gathering *g, struct link link) {
    struct merged a = g->merged[link.low], b = g->merged[link.high];
    double weight = a.parity ^ b.parity ? -link.weight : link.weight;
    return a.into < b.into ? (struct link){a.into, b.into, weight} : (struct link){b.into, a.into, weight};
}

/* Moves all links to the new clusters and adds up those between the same two: sorted by low, then summed by high. */
static void gather(struct cocone_gathering *g) {
    for (size_t i = 0; i <= g->clusters; i++) g->begin[i] = 0;
    size_t kept = 0;
    for (size_t i = 0; i < g->count; i++) {
        struct link link = moved(g, g->link[i]);
        if (link.low == link.high) continue;
        g->link[kept++] = link;
        g->begin[link.low]++;
    }
    for (size_t i = 0; i < g->clusters; i++) g->begin[i + 1] += g->begin[i];
    for (size_t i = kept; i-- > 0;) g->next[--g->begin[g->link[i].low]] = g->link[i];
    g->count = 0;
    for (uint32_t c = 0; c < g->clusters; c++) {
        for (uint32_t i = g->begin[c]; i < g->begin[c + 1]; i++)
            sums_add(&g->sums, c, g->next[i].high, g->next[i].weight);
        g->count += sums_flush(&g->sums, c, g->link + g->count);
    }
}

static void gather_all(struct cocone_gathering *g) {
    while (g->count > 0) {
        find_best(g);
        join_best(g, least_weight(g));
        number_clusters(g);
        gather(g);
    }
}

enum status cocone_gathering_new(const struct cocone_star *star, struct cocone_gathering **room) {
    /* In a triangulation of the sphere in four dimensions there are as many edges as cells and vertices together. */
    size_t nodes = star->n + 1, links = star->tets->cell_count + nodes;
    struct cocone_gathering *g = alloc_zeroed(1, sizeof *g);
    if (!g) return STATUS_NO_MEMORY;
    g->nodes = g->clusters = nodes;
    g->link = alloc_array(links, sizeof *g->link);
    g->next = alloc_array(links, sizeof *g->next);
    g->root = alloc_array(nodes, sizeof *g->root);
    g->best = alloc_array(nodes, sizeof *g->best);
    g->merged = alloc_array(nodes, sizeof *g->merged);
    g->rank = alloc_array(nodes, sizeof *g->rank);
    g->begin = alloc_array(nodes + 1, sizeof *g->begin);
    g->disjoint_set = (struct disjoint_set){alloc_array(nodes, sizeof(uint32_t)), alloc_zeroed(nodes, 1),
                                            alloc_array(nodes, sizeof(uint32_t))};
    g->sums = (struct sums){alloc_array(nodes, sizeof(struct sum)), alloc_array(nodes, sizeof(uint32_t)), 0};
    bool ok = g->link && g->next && g->root && g->best && g->merged && g->rank && g->begin;
    if (!ok || !g->disjoint_set.parent || !g->disjoint_set.parity || !g->disjoint_set.size || !g->sums.sum ||
        !g->sums.ids) {
        cocone_gathering_free(g);
        return STATUS_NO_MEMORY;
    }
    for (uint32_t i = 0; i < nodes; i++) {
        g->disjoint_set.parent[i] = g->root[i] = i;
        g->disjoint_set.size[i] = 1;
        g->sums.sum[i].low = NONE;
    }
    *room = g;
    return STATUS_OK;
}

void cocone_gathering_free(struct cocone_gathering *g) {
    if (!g) return;
    free(g->link), free(g->next);
    free(g->root), free(g->best), free(g->merged), free(g->rank), free(g->begin);
    free(g->disjoint_set.parent), free(g->disjoint_set.parity), free(g->disjoint_set.size);
    free(g->sums.sum), free(g->sums.ids);
    free(g);
}

/* ------------------------------------------------------------------------------------------------ normals */

void cocone_orient_turn(const struct cocone_star *star, struct cocone_frame *frame, struct cocone_lies *lies,
                        uint32_t vertex) {
    cocone_frame_turn(frame, vertex);
    for (uint32_t i = star->begin[vertex]; i < star->begin[vertex + 1]; i++) {
        float *lie = &lies->lie[cocone_star_cell(star->corner[i])][cocone_star_index(star->corner[i])];
        *lie = -*lie;
    }
}

static void turn_normals(const struct cocone_star *star, struct disjoint_set *disjoint_set, struct cocone_frame *frame,
                         struct cocone_lies *lies) {
    uint8_t out, parity;
    find(disjoint_set, (uint32_t)star->n, &out);
    for (uint32_t v = 0; v < star->n; v++) {
        find(disjoint_set, v, &parity);
        if (parity != out && star->begin[v] < star->begin[v + 1]) cocone_orient_turn(star, frame, lies, v);
    }
}

static size_t count_conflicts(const struct cocone_star *star, const struct cocone_lies *lies) {
    size_t conflicts = 0;
    for (size_t c = 0; c < star->tets->finite_count; c++) {
        int seen = 0;
        for (int i = 0; i < 4; i++) seen |= (lies->lie[c][i] > CERTAIN) | (lies->lie[c][i] < -CERTAIN) << 1;
        conflicts += seen == 3;
    }
    return conflicts;
}

/* Makes links within a piece positive: points near enough to each other, for those that they stand for. */
static void keep_sides(const struct cocone_star *star, const double *support, struct cocone_gathering *g) {
    uint32_t *piece = g->rank; /* not used yet */
    for (uint32_t v = 0; v < g->nodes; v++) piece[v] = v;
    for (size_t i = 0; i < g->count; i++) {
        uint32_t a = g->link[i].low, b = g->link[i].high;
        if (b < star->n && vec3_distance(star->point[a], star->point[b]) < NEAR * (support[a] + support[b]))
            disjoint_set_unite(piece, a, b);
    }
    for (size_t i = 0; i < g->count; i++) {
        struct link *link = &g->link[i];
        if (link->high < star->n && disjoint_set_root(piece, link->low) == disjoint_set_root(piece, link->high))
            link->weight = fabs(link->weight);
    }
}

size_t cocone_orient(const struct cocone_star *star, const double *support, struct cocone_frame *frame,
                     struct cocone_lies *lies, struct cocone_gathering *room) {
    room->count = link_vertices(star, (const float(*)[4])lies->lie, &room->sums, room->link);
    if (support) keep_sides(star, support, room);
    gather_all(room);
    turn_normals(star, &room->disjoint_set, frame, lies);
    return count_conflicts(star, lies);
}

size_t cocone_orient_doubt(const struct cocone_star *star, const uint8_t *inside, const struct cocone_lies *lies,
                           uint32_t *list) {
    size_t count = 0;
    for (uint32_t v = 0; v < star->n; v++) {
        double agreement = 0;
        for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++) {
            uint32_t cell = cocone_star_cell(star->corner[i]);
            double lie = (double)lies->lie[cell][cocone_star_index(star->corner[i])];
            agreement += inside[cell] ? -lie : lie;
        }
        if (agreement < 0) list[count++] = v;
    }
    return count;
}
