/* Each record is known by the lowest one at its place with the same attributes; records of a place are a chain.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/given/seams.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/attribute_names.h"
#include "core/mesh/halfedge.h"

enum { ATTRIBUTES_MOST = 8, RECORDS_MOST = 64 /* that are told apart at one place */, SEAMS_SHARE = 4 };

struct seams {
    const struct cloud *cloud;
    const struct ordered_points *points;
    const struct property *property[ATTRIBUTES_MOST];
    size_t properties;
    uint32_t *alike, *next; /* of each point of the cloud: the lowest like it; the next of a chain of unlike ones */
};

static void add_normals(struct seams *s) {
    static const char *const names[] = {"nx", "ny", "nz"};
    for (size_t k = 0; k < 3; k++) {
        const struct property *property = attribute_find(s->cloud, names[k]);
        if (property) s->property[s->properties++] = property;
    }
}

static bool is_alike(const struct seams *s, uint32_t a, uint32_t b) {
    const unsigned char *x = s->cloud->record + a * s->cloud->record_bytes;
    const unsigned char *y = s->cloud->record + b * s->cloud->record_bytes;
    for (size_t j = 0; j < s->properties; j++) {
        size_t at = s->property[j]->offset_bytes;
        if (memcmp(x + at, y + at, scalar_bytes(s->property[j]->type)) != 0) return false;
    }
    return true;
}

/* Whether any place has unlike records. */
static bool tell_apart(struct seams *s) {
    bool any = false;
    memset(s->next, 0xff, s->cloud->count * sizeof *s->next);
    for (uint32_t i = 0; i < s->cloud->count; i++) {
        uint32_t p = s->points->distinct[i], at = p == NONE ? i : s->points->original[p];
        size_t length = 0;
        while (at != i && !is_alike(s, at, i) && ++length < RECORDS_MOST) {
            any = true;
            if (s->next[at] == NONE) s->next[at] = i;
            at = s->next[at];
        }
        s->alike[i] = at;
    }
    return any;
}

static bool is_seam(const struct seams *s, const struct faces *faces, const struct halfedge *he, uint32_t h) {
    const uint32_t *record = faces->record[0];
    uint32_t g = he->twin[h];
    return g != NONE && (s->alike[record[h]] != s->alike[record[halfedge_next(g)]] ||
                         s->alike[record[halfedge_next(h)]] != s->alike[record[g]]);
}

static size_t count_seams(const struct seams *s, const struct faces *faces, const struct halfedge *he) {
    size_t count = 0;
    for (uint32_t h = 0; h < 3 * faces->count; h++) count += is_seam(s, faces, he, h);
    return count / 2;
}

/* Whether seams stay so few that something can be simplified, with the attributes that there are now. */
static bool are_few(struct seams *s, const struct faces *faces, const struct halfedge *he, struct faces_facts *facts) {
    facts->seams = tell_apart(s) ? count_seams(s, faces, he) : 0;
    return facts->seams <= 3 * faces->count / 2 / SEAMS_SHARE;
}

static void forget(struct faces *faces) {
    free(faces->record);
    faces->record = NULL;
}

static enum status keep(const struct seams *s, const struct halfedge *he, struct faces *faces) {
    faces->on_seam = alloc_zeroed(s->points->count, 1);
    if (!faces->on_seam) return STATUS_NO_MEMORY;
    for (uint32_t h = 0; h < 3 * faces->count; h++)
        if (is_seam(s, faces, he, h)) faces->on_seam[halfedge_from(he, h)] = faces->on_seam[halfedge_to(he, h)] = 1;
    for (size_t v = 0; v < he->vertex_count; v++) faces->on_seam[v] |= he->locked[v] == HALFEDGE_KNOTTED;
    for (size_t t = 0; t < faces->count; t++)
        for (int k = 0; k < 3; k++) faces->record[t][k] = s->alike[faces->record[t][k]];
    return STATUS_OK;
}

static enum status choose(struct seams *s, const struct halfedge *he, struct faces *faces, struct faces_facts *facts) {
    if (attribute_find_texture(s->cloud, s->property)) s->properties = 2;
    size_t textured = s->properties;
    add_normals(s);
    bool few = are_few(s, faces, he, facts);
    if (!few) s->properties = textured, facts->seams_dropped = true;
    if (!few && textured) few = are_few(s, faces, he, facts);
    if (!few) facts->seams = 0;
    if (facts->seams) return keep(s, he, faces);
    forget(faces);
    return STATUS_OK;
}

static void count_facts(const struct faces *faces, const struct halfedge *he, struct faces_facts *facts) {
    for (size_t v = 0; v < he->vertex_count; v++) {
        facts->used += he->out[v] != NONE;
        facts->knotted += he->out[v] != NONE && he->locked[v] == HALFEDGE_KNOTTED;
    }
    for (size_t h = 0; h < 3 * faces->count; h++) facts->borders += he->twin[h] == NONE;
}

enum status seams_find(const struct cloud *cloud, const struct ordered_points *points, unsigned threads,
                       struct faces *faces, struct faces_facts *facts) {
    const struct mesh mesh = {
        .vertex_count = points->count, .triangle_count = faces->count, .triangle = faces->triangle};
    struct halfedge he = {0};
    enum status status = halfedge_init(&he, &mesh, threads);
    if (!status) count_facts(faces, &he, facts);
    if (!status && points->count < cloud->count) {
        struct seams s = {.cloud = cloud, .points = points};
        s.alike = alloc_array(cloud->count, sizeof *s.alike), s.next = alloc_array(cloud->count, sizeof *s.next);
        status = s.alike && s.next ? choose(&s, &he, faces, facts) : STATUS_NO_MEMORY;
        free(s.alike), free(s.next);
    } else if (!status) {
        forget(faces);
    }
    halfedge_done(&he);
    return status;
}
