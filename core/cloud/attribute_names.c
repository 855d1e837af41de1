/* One table of names, for whoever looks for an attribute or joins clouds.
 *
 * Names are compared without capitals and without what stands between their words: "GPS Time", "gps_time" and "GpsTime"
 * are all "gpstime".  "scalar_" before a name is CloudCompare's.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/attribute_names.h"

#include <ctype.h>
#include <stddef.h>
#include <string.h>
#include <strings.h>

enum { PLAIN_BYTES = 32 };

/* The usual name, and all names that say the same, plain. */
static const char *const rows[][2] = {
    {"red", "red r diffusered colorred colourred"},
    {"green", "green g diffusegreen colorgreen colourgreen"},
    {"blue", "blue b diffuseblue colorblue colourblue"},
    {"alpha", "alpha a diffusealpha coloralpha colouralpha"},
    {"nir", "nir infrared nearinfrared"},
    {"nx", "nx normalx normalsx"},
    {"ny", "ny normaly normalsy"},
    {"nz", "nz normalz normalsz"},
    {"intensity", "intensity intensities"},
    {"classification", "classification class classid"},
    {"label", "label labels"},
    {"gps_time", "gpstime timestamp time"},
    {"return_number", "returnnumber return"},
    {"number_of_returns", "numberofreturns returns"},
    {"scan_angle_rank", "scananglerank"},
    {"scan_angle", "scanangle"},
    {"point_source_id", "pointsourceid"},
    {"user_data", "userdata"},
    {"curvature", "curvature"},
    {"deviation", "deviation"},
};
enum { ROWS = sizeof rows / sizeof rows[0] };

static const char *without_scalar(const char *name) {
    static const char before[] = "scalar_";
    size_t n = sizeof before - 1;
    return strncasecmp(name, before, n) == 0 && name[n] ? name + n : name;
}

/* Letters and digits alone, in small letters; false where that is longer than any known name. */
static bool make_plain(const char *name, char plain[PLAIN_BYTES]) {
    size_t used = 0;
    for (const char *c = without_scalar(name); *c; c++) {
        if (strchr(" \t_-.:", *c)) continue;
        if (used + 1 == PLAIN_BYTES) return false;
        plain[used++] = (char)tolower((unsigned char)*c);
    }
    plain[used] = 0;
    return used > 0;
}

static bool is_among(const char *words, const char *word) {
    size_t n = strlen(word);
    for (const char *at = words; *at;) {
        size_t length = strcspn(at, " ");
        if (length == n && memcmp(at, word, n) == 0) return true;
        at += length + (at[length] == ' ');
    }
    return false;
}

const char *attribute_usual_name(const char *name) {
    char plain[PLAIN_BYTES];
    if (!make_plain(name, plain)) return NULL;
    for (size_t i = 0; i < ROWS; i++)
        if (is_among(rows[i][1], plain)) return rows[i][0];
    return NULL;
}

bool attribute_is_same(const char *a, const char *b) {
    const char *usual_a = attribute_usual_name(a), *usual_b = attribute_usual_name(b);
    if (usual_a || usual_b) return usual_a == usual_b;
    return strcasecmp(without_scalar(a), without_scalar(b)) == 0;
}

const struct property *attribute_find(const struct cloud *cloud, const char *name) {
    const struct property *same = NULL;
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *p = &cloud->property[j];
        if (p->is_list) continue;
        if (strcmp(p->name, name) == 0) return p;
        if (!same && attribute_is_same(p->name, name)) same = p;
    }
    return same;
}

/* Letters as short as these are names of other things, too: they count in pairs, and as they are. */
bool attribute_find_texture(const struct cloud *cloud, const struct property *texture[2]) {
    static const char *const pairs[][2] = {
        {"s", "t"}, {"u", "v"}, {"texture_u", "texture_v"}, {"texture_s", "texture_t"}, {"tu", "tv"}};
    for (size_t i = 0; i < sizeof pairs / sizeof *pairs; i++) {
        const struct property *found[2] = {NULL, NULL};
        for (size_t j = 0; j < cloud->property_count; j++)
            for (int k = 0; k < 2; k++)
                if (!cloud->property[j].is_list && strcasecmp(cloud->property[j].name, pairs[i][k]) == 0)
                    found[k] = &cloud->property[j];
        if (!found[0] || !found[1]) continue;
        texture[0] = found[0], texture[1] = found[1];
        return true;
    }
    return false;
}
