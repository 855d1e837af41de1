/* Attributes of vertices.
 *
 * Colours come as uint8, as uint16 (LAS), or as floats of 0 .. 1 or 0 .. 255 (OFF, OBJ, text).  What white is, is told
 * by the largest number: at most 1 in floats, at most 255, else 65535.  Where all are 0, as in LAS of a format with
 * colours whose points were never given any, there are none: a mesh of them would be black.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/mesh_attributes.h"

#include <stdio.h>
#include <string.h>

#include "core/cloud/attribute_names.h"

static bool all_vertices_have_source(const struct mesh *mesh) {
    for (size_t v = 0; mesh->source && v < mesh->vertex_count; v++)
        if (mesh->source[v] == NONE) return false;
    return mesh->source != NULL;
}

const unsigned char *mesh_attributes_record(const struct mesh_attributes *attributes, size_t v) {
    return attributes->cloud->record + attributes->mesh->source[v] * attributes->cloud->record_bytes;
}

static double load(const struct mesh_attributes *a, const struct property *property, size_t v) {
    return scalar_load(mesh_attributes_record(a, v) + property->offset_bytes, property->type);
}

/* 0 where nothing has a colour. */
static double find_scale(const struct mesh_attributes *a) {
    double largest = 0;
    bool bytes = a->colour[0]->type == SCALAR_UINT8; /* of which any tells */
    for (size_t v = 0; v < a->mesh->vertex_count && !(bytes && largest > 0); v++)
        for (int k = 0; k < 3; k++) largest = fmax(largest, load(a, a->colour[k], v));
    if (!(largest > 0)) return 0;
    if (a->colour[0]->type >= SCALAR_FLOAT32 && largest <= 1) return 1;
    return largest <= 255 ? 1.0 / 255 : 1.0 / 65535;
}

void mesh_attributes_find(const struct mesh *mesh, const struct cloud *cloud, struct mesh_attributes *attributes) {
    static const char *const normal[3] = {"nx", "ny", "nz"}, *const colour[4] = {"red", "green", "blue", "alpha"};
    *attributes = (struct mesh_attributes){.mesh = mesh};
    if (!cloud || !all_vertices_have_source(mesh)) return;
    attributes->cloud = cloud;
    for (int k = 0; k < 3; k++) attributes->normal[k] = attribute_find(cloud, normal[k]);
    for (int k = 0; k < 4; k++) attributes->colour[k] = attribute_find(cloud, colour[k]);
    for (int k = 0; k < 3; k++) {
        if (!attributes->normal[k]) memset(attributes->normal, 0, sizeof attributes->normal);
        if (!attributes->colour[k]) memset(attributes->colour, 0, sizeof attributes->colour);
    }
    if (!attribute_find_texture(cloud, attributes->texture)) memset(attributes->texture, 0, sizeof attributes->texture);
    if (attributes->colour[0]) attributes->colour_scale = find_scale(attributes);
    if (attributes->colour_scale == 0) memset(attributes->colour, 0, sizeof attributes->colour);
}

vec3 mesh_attributes_normal(const struct mesh_attributes *a, size_t v) {
    return (vec3){load(a, a->normal[0], v), load(a, a->normal[1], v), load(a, a->normal[2], v)};
}

void mesh_attributes_texture(const struct mesh_attributes *a, size_t v, double st[2]) {
    for (int k = 0; k < 2; k++) st[k] = load(a, a->texture[k], v);
}

void mesh_attributes_colour(const struct mesh_attributes *a, size_t v, double rgba[4]) {
    for (int k = 0; k < 4; k++) {
        double value = a->colour[k] ? load(a, a->colour[k], v) * a->colour_scale : 1;
        rgba[k] = value > 0 ? fmin(value, 1) : 0; /* NaN too */
    }
}

bool mesh_attributes_knows(const struct mesh_attributes *attributes, const struct property *property) {
    for (int k = 0; k < 3; k++)
        if (attributes->normal[k] == property) return true;
    for (int k = 0; k < 4; k++)
        if (attributes->colour[k] == property) return true;
    for (int k = 0; k < 2; k++)
        if (attributes->texture[k] == property) return true;
    return false;
}

bool mesh_attributes_fit_f32(const struct mesh *mesh) {
    for (size_t v = 0; v < mesh->vertex_count; v++)
        for (int axis = 0; axis < 3; axis++) {
            double value = (&mesh->vertex[v].x)[axis];
            if ((double)(float)value != value) return false;
        }
    return true;
}

double mesh_attributes_f32_error(const struct mesh *mesh, vec3 origin) {
    double worst = 0;
    for (size_t v = 0; v < mesh->vertex_count; v++)
        for (int axis = 0; axis < 3; axis++) {
            double value = (&mesh->vertex[v].x)[axis], from = (&origin.x)[axis];
            worst = fmax(worst, fabs((double)(float)(value - from) + from - value));
        }
    return worst;
}

/* Appends ", name", or "..." once there is no room. */
static void append(char *text, size_t bytes, const char *name) {
    size_t used = strlen(text);
    if (used + strlen(name) + 8 < bytes)
        snprintf(text + used, bytes - used, "%s%s", used ? ", " : "", name);
    else if (used < 3 || strcmp(text + used - 3, "...") != 0)
        snprintf(text + used, bytes - used, ", ...");
}

void mesh_attributes_note(const struct mesh_attributes *attributes, const struct cloud *cloud, const char *where,
                          bool (*keeps)(const struct mesh_attributes *attributes, const struct property *property),
                          bool keeps_tags, struct left_out *left_out) {
    char names[LEFT_OUT_TEXT_BYTES - 40] = "";
    const struct mesh *mesh = attributes->mesh;
    for (size_t j = 0; cloud && j < cloud->property_count; j++)
        if (cloud_axis_of(cloud, j) < 0 && !(attributes->cloud && keeps && keeps(attributes, &cloud->property[j])))
            append(names, sizeof names, cloud->property[j].name);
    if (names[0]) left_out_add(left_out, where, "properties of the points: %s", names);
    for (size_t t = 0; !keeps_tags && mesh->tag && t < mesh->triangle_count; t++)
        if (mesh->tag[t] == MESH_HOLE_FILL) {
            left_out_add(left_out, where, "which triangles fill holes");
            break;
        }
}
