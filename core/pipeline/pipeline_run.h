/* What the steps of the pipeline share.  For core/pipeline*.c alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PIPELINE_PIPELINE_RUN_H
#define WHITTLE_CORE_PIPELINE_PIPELINE_RUN_H

#include "core/cloud/morton.h"
#include "core/measure/metro.h"
#include "core/pipeline/pipeline.h"
#include "core/pipeline/topology.h"
#include "core/refine/local_delaunay.h"
#include "core/refine/samples.h"
#include "core/simplify/contract.h"
#include "core/simplify/quadric.h"
#include "core/spatial/knn.h"
#include "core/spatial/neighbourhood.h"
#include "core/surface/given/faces.h"
#include "core/surface/reconstruct.h"
#include "core/surface/sheet/eye.h"
#include "core/surface/sheet/gallery.h"
#include "core/surface/sheet/kind.h"
#include "core/surface/sheet/lattice.h"
#include "core/surface/sheet/sweep.h"
#include "core/surface/tets.h"

/* Points that are to be triangulated: positions and normals of the points `id`, and how far the surface around each is
 * known to reach. */
struct sites {
    size_t count;
    uint32_t *id; /* ascending, so along the curve */
    vec3 *point, *normal;
    double *support;
    uint32_t *of_point; /* of each point along the curve: which of the sites stands for it */
    size_t made;        /* so many of the sites, the last ones, are made up (struct made_points) */
};

/* Where points were seen from, in the frame: all from one place, or each of those along the curve from its own. */
struct views {
    bool is_one;
    vec3 one;
    vec3 *each; /* NULL = not known, or one; owned */
};

/* What the points tell of where they were seen from. */
struct scan_pattern {
    bool order_sought; /* sweep is known: where the points were seen from, by their order in the input */
    struct sweep sweep;
    bool origin_asked;      /* whether it is the place of the lattice: if so, that is known */
    bool lattice_sought;    /* lattice is known: the same by their rays, whatever the order */
    struct lattice lattice; /* in the input's coordinates */
    bool globe;             /* instead, they tell of the middle of one: they face away from there */
    vec3 middle;            /* in the input's coordinates */
    bool sought;            /* the rest is known */
    size_t places;          /* 0 = nothing was found */
    struct views views;     /* by the order of the points each has its own; by the lattice of their rays there is one */
    bool told_checked, agrees, denies; /* what the rays say of a place that was told; neither where they tell nothing */
    vec3 seen_from;                    /* what is, then; in the input's coordinates */
    bool hides;                        /* many of the points are behind others from the place that was told */
};

/* What a mesh is worth before it is fitted. */
struct surface_judged {
    struct topology topology;
    double mean;    /* distance of the points to it */
    double spacing; /* of the points */
    bool joined;    /* it has fewer pieces than the points are known to have, which its topology tells */
};

/* So much farther from the points than another mesh that it lacks a sheet. */
static inline bool surface_is_lost(const struct surface_judged *judged, const struct surface_judged *by) {
    static const double LOST = 0.1 /* of the spacing */, MUCH_NEARER = 0.4;
    return judged->mean > LOST * judged->spacing && by->mean < MUCH_NEARER * judged->mean;
}

/* The closed surface of many of the points; zeroed: it hasn't been looked for. */
struct dense_surface {
    size_t from;      /* as many of the points; then without a mesh: there is none */
    size_t trial;     /* DENSE_BY_CELLS or another */
    size_t pieces;    /* without a mesh: it has more than so many; 0: that isn't why there is none */
    bool plain;       /* its diagonals are as they were reconstructed */
    bool blunt;       /* its points are beside the creases of a body, which it cuts off */
    struct mesh mesh; /* sources are ids along the curve */
    struct topology topology;
};

enum {
    DENSE_WITH_FACES,
    DENSE_BY_CELLS,
    DENSE_FIRST,
    DENSE_USUAL,
    DENSE_PLAIN,
    DENSE_FEWER,
    DENSE_FEWEST,
    DENSE_TRIALS
};

/* Triangles as ids of points along the curve; from n on, those of vertices that stand at none. */
struct surface_faces {
    size_t count;
    uint32_t (*face)[3]; /* owned; NULL = there are none */
    /* Of all points, and of vertices at none: owned; NULL = there are no such vertices. */
    size_t n;
    vec3 *point, *normal;
    float *spacing;
};

/* Accepts zeroed ones. */
void surface_faces_done(struct surface_faces *faces);

/* Points on flat faces that have points along their edges alone: made up, and listed behind all points. */
struct made_points {
    bool sought;
    size_t count, holes; /* holes: core/spatial/flat_faces.h */
    /* Of all points and of these; owned; NULL where there are none. */
    vec3 *point, *normal;
    float *spacing;
    uint32_t *crease_of;    /* NULL: creases aren't known */
    struct creases creases; /* which are the run's, by crease_of */
    struct knn *knn;
};

/* The mesh of the kept points, and what the report told of it. */
struct mesh_aside {
    struct mesh mesh; /* without triangles: none is put aside */
    size_t from, points_lost, vertices_split;
};

/* The k most important points, and their tetrahedra; k = 0: none. */
struct many {
    size_t k;
    struct sites sites;
    struct tets tets;
};

struct sheet_sides;

struct run {
    const struct cloud *cloud;
    const struct params *params;
    struct progress progress; /* of the step that runs: turns its fraction into the whole's */
    struct error *error;
    unsigned threads;
    bool mesh_follows;  /* steps 9 and later come */
    bool surface_alone; /* no step after the one that decides what the surface is, and nothing but what decides it */
    bool faces_alone;   /* the mesh of the input's faces is all that is asked for: steps for the points are left out */
    struct ordered_points points;
    vec3 *moved; /* of every input point, by its id: where denoising puts it; NULL where it moves none */
    struct knn *knn;
    struct neighbourhood neighbours;
    vec3 *normal;
    struct creases creases; /* for meshes */
    float *dso;
    enum placement placement; /* of vertices, with the surface that is known by now: never PLACEMENT_AUTO */
    uint8_t *turned;          /* of each normal: it is written the other way round; NULL unless normals are written */
    bool normals_fit;         /* those that the input has are there, and fit its points */
    bool seen_from_origin;    /* a PCD whose points may all have been seen from there */
    struct packed_quadric *quadrics;
    struct contraction contraction;
    size_t level;      /* the one that the steps work on */
    size_t kept_count; /* of that level */
    size_t fits;       /* at most so many points may be kept: all, or what the spacing has room for */
    size_t searched;   /* at least so many points are kept, since the deviation asks for them; 0 = it doesn't */
    uint32_t *kept;    /* of the finest level, along the curve's ids, most important first; NULL: nobody asks which */
    struct sites sites;
    struct faces faces;            /* the input's own, where they are the surface; else zeroed */
    uint32_t *record;              /* of each vertex of a mesh with seams its point of the cloud; NULL = it has none */
    struct surface_choice surface; /* of the whole cloud, made with the first mesh */
    struct surface_signs signs;    /* that it is made by */
    enum { UNDECIDED, LOOKED_AT, DECIDED } decision;
    bool two_sided;         /* most points are on both sides of thin plates (core/spatial/two_sheets.h) */
    bool bars_sought, bars; /* whether many points are on thin bars (core/spatial/tube.h) */
    bool rods;              /* still more, and these bars are round: what turns sharply there is no crease */
    /* What of the choice is over, for all levels: README.md has its order. */
    bool field_judged; /* whether a height field is one */
    bool field_left;   /* it was left for its steps, and may come back where it is nearer */
    bool field_tried;  /* it was made in place of another surface, and is not doubted for its walls */
    double lid_share;  /* of the closed mesh that was judged last: of its area, where there are no points */
    bool closed_judged, view_judged; /* whether a closed surface is one; whether a place has seen all points */
    bool rough;         /* run->mesh is closed and faces away: it was made to be judged, and is made anew if it stays */
    bool quarter_asked; /* whether a quarter of the kept points tells of a lid, before there were tetrahedra of all */
    bool lid_doubted;   /* and then its lid is judged, which was in doubt */
    bool landscape;     /* seen from above, as surface_is_landscape has it */
    bool sides_wait;    /* a surface with borders isn't turned yet, as a height field may take its place */
    bool viewed;        /* the surface with borders is made as it is seen from view */
    vec3 view;
    struct plane_reach plane; /* of the points, for height fields */
    struct gallery gallery;   /* of the last sheet that nothing else told the sides of */
    bool faces_inwards;       /* the last sheet: most of it faces what it sees, as a room does */
    int8_t *outside;          /* of each point, where a closed mesh was left for its lid alone: 1 where its outside is
                               * where the point's normal goes to, -1 on the other side, 0 not known; else NULL */
    struct scan_pattern pattern;
    struct local_delaunay local_delaunay; /* for the refinement, which empties them, as it does the samples */
    struct samples samples;
    struct tets tets;
    struct many ahead; /* what the surface with borders will be made of, where that of the kept points is left out */
    float *distance; /* of every distinct point to the finest mesh, or, without one, to the tangent plane at the nearest
                        kept point; normalised; NULL unless asked for */
    float *of_dropped; /* the same of every point that was dropped, in the order of the input, to the finest mesh; NULL
                          as that, or where there are none */
    struct mesh mesh;  /* sources are ids along the curve */
    struct dense_surface dense[DENSE_TRIALS];
    size_t dense_tried;               /* so many of them, for this level */
    size_t islands;                   /* pieces that the points tell of (topology.h); 0 = not known */
    double gaps;                      /* of the next surface (struct reconstruct_input); 0 = 1 */
    struct reconstruct_pieces pieces; /* likewise; zeroed: any number */
    bool sharpened;                   /* the last of them, which run->mesh is of, has sharp creases */
    bool anywhere;                    /* the last one's points are on no edges of a body, and exact enough for it */
    bool noise_asked;                 /* whether least_noise is known */
    double least_noise;               /* of all points (noise_where_least) */
    bool stay_blunt;                  /* it isn't to have them, as it wasn't taken with them */
    vec3 *told;              /* normals of all points, as the last of them has told them; NULL: as below; owned */
    vec3 *mended;            /* the same by their Voronoi cells, for all levels; NULL: they are no others; owned */
    bool cells_seen;         /* those cells have been looked at */
    bool by_cells;           /* the last of them was made with such normals, which count; else as they were fitted */
    struct made_points made; /* for all levels */
    bool with_made;          /* the last of them was made with such points, which count */
    struct mesh_aside aside; /* while run->mesh is of a dense surface */
    struct surface_faces fitted_to; /* of the surface through all points that run->mesh was made of */
    struct report report;
};

/* The steps, in their order (core/pipeline/pipeline.c says what each does).  Each fills its own members of struct run,
 * and run->error where it fails, but for those that run beside others: local Delaunay triangles, tangent, examine. */
enum status pipeline_order(struct run *run) MUST_CHECK;
enum status pipeline_denoise(struct run *run) MUST_CHECK;
/* Drops the outliers of a cloud for whose mesh these are looked for, where its neighbourhoods say that there are
 * strays: these are forgotten then, or become those of what is left. */
enum status pipeline_drop_strays(struct run *run, bool *dropped) MUST_CHECK;
struct neighbourhood_options pipeline_neighbourhood_options(const struct run *run);
enum status pipeline_neighbours(struct run *run) MUST_CHECK;
enum status pipeline_normals(struct run *run) MUST_CHECK;
enum status pipeline_sides(struct run *run) MUST_CHECK;
enum status pipeline_dso(struct run *run) MUST_CHECK;
enum status pipeline_quadrics(struct run *run) MUST_CHECK;
enum status pipeline_contract(struct run *run) MUST_CHECK;
enum status pipeline_space(struct run *run) MUST_CHECK;
enum status pipeline_search(struct run *run) MUST_CHECK;
enum status pipeline_keep(struct run *run) MUST_CHECK;
enum status pipeline_local_delaunay(struct run *run) MUST_CHECK;
enum status pipeline_tangent(struct run *run) MUST_CHECK;
enum status pipeline_faces(struct run *run) MUST_CHECK;
enum status pipeline_delaunay(struct run *run) MUST_CHECK;
enum status pipeline_reconstruct(struct run *run) MUST_CHECK;
enum status pipeline_refine(struct run *run) MUST_CHECK;
enum status pipeline_close_holes(struct run *run) MUST_CHECK;
enum status pipeline_vertices(struct run *run) MUST_CHECK;
enum status pipeline_examine(struct run *run) MUST_CHECK;
enum status pipeline_measure(struct run *run) MUST_CHECK;
enum status pipeline_verify(struct run *run) MUST_CHECK;
enum status pipeline_distances(struct run *run) MUST_CHECK;

/* Runs the steps before `delaunay` that were left out for run->faces_alone. */
enum status pipeline_turn_to_points(struct run *run) MUST_CHECK;

/* Whether it matters how far each point is from tangent planes, since there is no mesh. */
static inline bool pipeline_wants_planes(const struct params *params) {
    return (params->outputs & OUTPUT_PREVIEW || params_bound_deviation(params)) && !params_want_mesh(params);
}

/* What is bounded of deviations, in the input's units; and how many points may be farther. */
double pipeline_deviation_bound(const struct run *run);
size_t pipeline_deviation_spare(const struct run *run);

/* How far points are from the result, in the input's units. */
struct reach {
    double at_share; /* all but those that may be farther: no farther than this */
    double max;
    size_t over;     /* points that are farther than the bound */
    size_t farthest; /* along the curve */
    bool holds;
};

/* Of all points to run->mesh, or, where none follows, to the tangent planes (run->distance).  STATUS_NO_MEMORY. */
enum status pipeline_find_reach(struct run *run, struct reach *reach) MUST_CHECK;

/* How many points a level is to keep: at least one, at most all distinct ones. */
size_t pipeline_wanted_points(const struct run *run, size_t level);

/* The input's normals along the curve, where they fit its points (*normal, to be freed, else stays NULL); and where it
 * was seen from (*views, zeroed; views->each to be freed).  STATUS_NO_MEMORY. */
enum status pipeline_given_normals(const struct run *run, vec3 **normal) MUST_CHECK;
enum status pipeline_views(const struct run *run, struct views *views) MUST_CHECK;

/* Finds whether the origin, which a PCD has for a viewpoint where nobody said, is where its points were seen from.
 * STATUS_NO_MEMORY. */
enum status pipeline_doubt_origin(struct run *run) MUST_CHECK;

/* The share of the points that is hidden from a place (hidden_share), and whether that is so much that the place can't
 * have seen them all.  STATUS_NO_MEMORY. */
enum status pipeline_hidden_from(const struct run *run, vec3 place, double *share, bool *hides) MUST_CHECK;

/* A place of the input in the frame of run->points. */
vec3 pipeline_in_frame(const struct run *run, vec3 p);

/* *range: to each point its distance from the one place that all were seen from, as the input, a parameter, the points'
 * order or their rays tell, at least a tenth of the median.  NULL where it isn't known.  The caller's to free. */
enum status pipeline_ranges(struct run *run, float **range) MUST_CHECK;

/* Fills run->pattern, once. */
enum status pipeline_seek_pattern(struct run *run) MUST_CHECK;

/* Whether the order of the points tells of one place that they were all seen from, but for parts of the order that it
 * tells nothing of. */
bool scan_pattern_one_place(const struct run *run, vec3 *place);

/* The one place that their rays tell exactly that all points were seen from, where that takes some hundredths of a
 * second: by the order of the points, or as the origin of the input, or as it was found before.  STATUS_NO_MEMORY. */
enum status scan_pattern_exact_place(struct run *run, bool *known, vec3 *place) MUST_CHECK;

/* Whether rays tell exactly of one place that all points were seen from, by their order or as a lattice, as far as that
 * has been looked for: from there nobody sees a solid's back, so the points are of none. */
bool scan_pattern_sees_no_back(const struct run *run);

/* Puts the place that all points were seen from, where their rays tell it exactly, in place of one that was told and is
 * far from it, and says so; says, too, where many points are hidden from one that was told.  STATUS_NO_MEMORY. */
enum status scan_pattern_check_told(struct run *run, struct views *views) MUST_CHECK;

/* Whether the input or a parameter tells where points were seen from, and *place where that is one (*known), checked as
 * above, that may have seen all of them.  STATUS_NO_MEMORY. */
enum status scan_pattern_told_place(struct run *run, bool *told, bool *known, vec3 *place) MUST_CHECK;

/* Normals of all points of the input, turned as run->turned says: an outlier has that of the first one.  New; NULL
 * without memory. */
float (*pipeline_spread_normals(const struct run *run))[3];

/* Frees what steps have made for a level, but for the kept points. */
void pipeline_leave_level(struct run *run);

/* Fills run->error and returns STATUS_NO_MEMORY. */
enum status pipeline_no_memory(struct run *run, const char *where);

/* Turns lengths of the normalised frame into the input's. */
void pipeline_scale(struct distance_stats *stats, double scale);

/* Puts the bounding box of run->points into the report. */
void pipeline_report_box(struct run *run);

/* The k most important points as sites, to be done with in any case. */
enum status pipeline_sites_of(const struct run *run, size_t k, struct sites *sites) MUST_CHECK;
void pipeline_sites_done(struct sites *sites);

/* The same with their tetrahedra, no more than the memory for those of the kept points has room for: else
 * STATUS_LIMIT. To be done with in any case. */
enum status pipeline_triangulate_many(const struct run *run, size_t k, struct many *many) MUST_CHECK;

/* Accepts zeroed ones. */
void pipeline_many_done(struct many *many);

/* The surface of all points, as the mesh of the kept ones is made; fills run->error where it fails.  *surface is the
 * caller's. */
enum status pipeline_reconstruct_all(struct run *run, struct mesh *surface) MUST_CHECK;

/* The surface of the sites, of one form, turned to its front; the mesh's sources become ids along the curve.  tets:
 * those of the sites; not looked at for a height field, nor for a surface that one place has seen (run->viewed).
 */
enum status pipeline_reconstruct_as(struct run *run, enum surface_form form, const struct sites *sites,
                                    const struct tets *tets, struct mesh *mesh,
                                    struct reconstruct_facts *facts) MUST_CHECK;

/* A surface with borders is nearer to the points when it is reconstructed from more of them: where sheets end, step or
 * stand upright, few points don't tell which of them are neighbours.  run->mesh becomes that, unless it can't be done,
 * or it is a height field and farther off; or points are to be apart, since others than the kept ones aren't. */
enum status pipeline_reconstruct_first(struct run *run, struct reconstruct_facts *facts) MUST_CHECK;

/* The same into run->mesh, which is empty, whether or not it is the better one (run->viewed). */
enum status pipeline_reconstruct_seen(struct run *run, struct reconstruct_facts *facts) MUST_CHECK;

/* What run->pattern tells of sides. */
void pipeline_see_from_pattern(const struct run *run, struct sheet_sides *sides);

/* Whether nothing is asked of the surface with borders of the kept points: neither whether a height field is nearer,
 * nor what one place sees. */
enum status pipeline_is_left_out(struct run *run, bool *left_out) MUST_CHECK;

/* The tetrahedra of the points that the surface with borders will be made of, where that of the kept ones is left out:
 * they are one thread's work, and made beside other steps. */
enum status pipeline_triangulate_ahead(struct run *run) MUST_CHECK;

/* How many tetrahedra the kept points may have between them, or all points. */
size_t pipeline_tetrahedra_allowed(const struct run *run, bool of_all, const struct params *params);

/* The tetrahedra of sites; fills run->error where it fails. */
enum status pipeline_triangulate(const struct run *run, const struct sites *sites, bool of_all,
                                 struct tets *tets) MUST_CHECK;

/* As pipeline_reconstruct_as, unless the probe (or NULL) says that what has been made so far is enough. */
enum status pipeline_reconstruct_unless(struct run *run, enum surface_form form, const struct sites *sites,
                                        const struct tets *tets, const struct reconstruct_probe *probe,
                                        struct mesh *mesh, struct reconstruct_facts *facts) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ other surfaces */

/* How a mesh goes through the points, all of which are known by now. */
enum status pipeline_match(const struct run *run, const struct mesh *mesh, struct surface_match *match) MUST_CHECK;

/* *view: the one place that all points were seen from, in the frame, if they, the input or a parameter tell of one
 * (*known). */
enum status pipeline_find_view(struct run *run, bool *known, vec3 *view) MUST_CHECK;

/* run->mesh, a surface with borders of the kept points, becomes that which is seen from the one place that all points
 * were seen from, of more of them, where some of it faces away from there (*taken), unless that misses points that the
 * other one goes through, as it does between rings that are far apart, or where that isn't the place.  For all levels.
 */
enum status pipeline_look_from_view(struct run *run, struct reconstruct_facts *facts, bool *taken) MUST_CHECK;

/* run->mesh, a height field of no landscape, becomes the surface with borders that is seen from the one place that all
 * points were seen from, where some of it faces away from there.  For all levels. */
enum status pipeline_doubt_field(struct run *run, struct reconstruct_facts *facts) MUST_CHECK;

/* run->mesh, a surface with borders or a closed one of the kept points, that were seen from above, becomes a height
 * field of more of them where that is hardly farther from all: it covers the ground once, and faces up. */
enum status pipeline_try_field(struct run *run, struct reconstruct_facts *facts) MUST_CHECK;

/* Whether so much of a closed mesh faces away from where the points were seen from that it can't be their surface: most
 * of it, or where it isn't surely closed and has a lid, that, which nobody saw; any of it, if one place has seen no
 * solid's back (scan_pattern_sees_no_back), which is looked for where it isn't surely closed. */
enum status pipeline_faces_away(struct run *run, const struct mesh *closed, bool sure, bool *away) MUST_CHECK;

/* A mesh with borders takes the place of a closed one that faces away from where the points were seen from, or whose
 * points are surely of no solid but of a room.  The closed one need not be as good as it may become: only its sides
 * count. */
enum status pipeline_doubt_side(struct run *run, const struct sites *sites, const struct tets *tets, struct mesh *mesh,
                                struct reconstruct_facts *facts) MUST_CHECK;

/* Where it isn't sure that the points are of a solid: a mesh with borders takes the place of the closed one if it goes
 * through them better, or if they are of a room. */
enum status pipeline_doubt_closed(struct run *run, const struct sites *sites, const struct tets *tets,
                                  struct mesh *mesh, struct reconstruct_facts *facts) MUST_CHECK;

/* The same of run->mesh before thin walls are looked for, which takes several meshes of more points, by a lid alone: a
 * mesh with borders takes its place if it has less area, is hardly farther from the points and lies along their
 * normals.  Only where none was judged before; where run->surface stays closed all else stays, too. */
enum status pipeline_doubt_lid(struct run *run, struct reconstruct_facts *facts) MUST_CHECK;

/* The closed surface of sites; the mesh's sources become ids along the curve. */
enum status pipeline_reconstruct_closed(struct run *run, const struct sites *sites, const struct tets *tets,
                                        struct mesh *mesh, struct reconstruct_facts *facts) MUST_CHECK;

/* All points, as those that a mesh of the sites stands for.  Borrows all of it. */
struct reconstruct_dense pipeline_dense_of(struct run *run, const struct sites *sites);

/* What the cloud is taken for from now on. */
void pipeline_decide(struct run *run, struct surface_choice choice);

/* Whether the surface is what the input's faces are. */
static inline bool pipeline_is_given(const struct run *run) {
    return run->decision == DECIDED && run->surface.form == SURFACE_GIVEN;
}

/* The mesh of the input's faces, with as many vertices as are kept, or as it can't do without; fills run->error where
 * it fails. */
enum status pipeline_collapse(struct run *run) MUST_CHECK;

/* run->mesh, which has seams, with one vertex at each of its places; its triangles are the caller's, all else is
 * run->mesh's.  STATUS_NO_MEMORY: then, too. */
enum status pipeline_join_seams(const struct run *run, struct mesh *joined) MUST_CHECK;

/* The share of the vertices of a mesh of points from which an edge runs across a wall.  STATUS_NO_MEMORY. */
enum status pipeline_find_lost(const struct run *run, const struct mesh *mesh, double *share) MUST_CHECK;

/* How many points a surface with thin walls is reconstructed from at most, and how many tetrahedra where most of the
 * cloud is such walls: of all points, as far as there is memory. */
size_t pipeline_wall_points(const struct run *run);
size_t pipeline_wall_tetrahedra(const struct run *run);

/* Puts a mesh that was reconstructed from more points in place of run->mesh, as params->order says.  run->mesh is
 * closed, and not refined yet.  STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status pipeline_resolve_walls(struct run *run, struct reconstruct_facts *facts) MUST_CHECK;

/* Whether a mesh of all points is to take the place of that of the kept ones, if the surface is closed.  It reads
 * nothing that changes while steps run side by side. */
bool pipeline_wants_dense(const struct run *run);

/* Puts it, or one of many points, collapsed to as many vertices, in place of run->mesh, which is put aside, where it is
 * as simple and nearer to the points: the first that is of those not tried yet.  run->mesh is not refined yet.
 * STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status pipeline_densify(struct run *run) MUST_CHECK;

/* Whether a mesh has more surface that isn't there than another, at so many places, or 0 (core/measure/phantom.h). */
enum status pipeline_find_phantom(const struct run *run, const struct mesh *mesh, const struct mesh *other,
                                  size_t places, bool *more) MUST_CHECK;

/* Whether a mesh, as it was judged, is to be preferred to run->mesh: nearer, without more phantom, and as simple.  It
 * may have more handles where run->mesh has certainly more phantom, as that has lids over holes then, and pieces as
 * well where that has lost a sheet: then it can't tell how many there are.  places: as above.  STATUS_NO_MEMORY. */
enum status pipeline_is_preferred(const struct run *run, const struct mesh *mesh, const struct surface_judged *judged,
                                  const struct surface_judged *than, size_t places, bool *preferred) MUST_CHECK;

/* Lists the triangles of a surface of all points, but those that close a cut, in the order of the lowest of their
 * points; the last `sharp` vertices stand at none of them.  STATUS_NO_MEMORY: *faces is to be done with in any case. */
enum status pipeline_list_faces(const struct run *run, const struct mesh *surface, size_t sharp,
                                struct surface_faces *faces) MUST_CHECK;

/* Puts the mesh back that was put aside. */
void pipeline_put_back(struct run *run);
void dense_surface_done(struct dense_surface *dense);

/* Looks for flat faces, once.  STATUS_NO_MEMORY. */
enum status made_points_find(struct run *run) MUST_CHECK;
/* Puts them behind sites that are all of the points.  STATUS_NO_MEMORY: then these are as they were. */
enum status made_points_add(const struct run *run, struct sites *sites) MUST_CHECK;
/* Brings what they know of the points' normals to what is told by now. */
void made_points_tell(const struct run *run);
void made_points_done(struct made_points *made);
/* What meshes are judged by: all points, and while they count those made up. */
struct metro_reference pipeline_reference(const struct run *run);

/* Normals of all points (unit, of either sign): those fitted to neighbours, but where a dense surface or their Voronoi
 * cells have told better ones. */
static inline const vec3 *pipeline_normals_told(const struct run *run) {
    return run->told ? run->told : run->by_cells && run->mended ? run->mended : run->normal;
}

enum { POINTS_OFF_MOST = 20000 /* as many as tell it exactly enough to judge by */ };

/* How far the points are from a mesh: of at most so many of them, evenly along the curve. */
struct points_off {
    double mean;                      /* of all alike */
    double mean_by_area, rms_by_area; /* and root mean square, each for the area around it: a body's densest places are
                                         small */
    double spacing;                   /* of the points, as root mean square by area */
};

/* STATUS_NO_MEMORY. */
enum status pipeline_points_off(const struct run *run, const struct mesh *mesh, size_t most,
                                struct points_off *off) MUST_CHECK;

/* Sets run->islands.  STATUS_NO_MEMORY. */
enum status pipeline_find_islands(struct run *run) MUST_CHECK;

/* Topology of a closed mesh, with no fewer pieces than the points are known to have, and how far these are from it in
 * the mean.  STATUS_NO_MEMORY. */
enum status pipeline_judge(struct run *run, const struct mesh *mesh, struct surface_judged *judged) MUST_CHECK;

/* What a mesh through other points than the kept ones tells of these: how many aren't there, and which vertices are
 * copies.  STATUS_NO_MEMORY. */
enum status pipeline_count_vertices(const struct run *run, const struct mesh *mesh,
                                    struct reconstruct_facts *facts) MUST_CHECK;

#endif
