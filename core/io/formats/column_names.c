/* What names of columns mean.
 *
 * A name is compared without case, unit, and what stands between its words: "Point X [m]", "point_x" and "PointX_m" are
 * all "pointx".  Each row below has names that mean the same, separated by blanks; rows stand in the order of
 * preference.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/formats/column_names.h"

#include <ctype.h>
#include <string.h>
#include <strings.h>

enum { PLAIN_BYTES = 32 };

/* ------------------------------------------------------------------------------------------------ tables */

enum { GEOGRAPHIC = 3 /* row of planes */ };

static const char *const planes[][2] = {
    {"x", "y"},
    {"xcoord xcoordinate coordx coordinatex pointx posx positionx xpos xposition points0 coords0 coordinates0",
     "ycoord ycoordinate coordy coordinatey pointy posy positiony ypos yposition points1 coords1 coordinates1"},
    {"easting eastings east", "northing northings north"},
    {"lon long lng longitude", "lat latitude"},
    {"e", "n"},
};

static const char *const heights[] = {
    "z",
    "zcoord zcoordinate coordz coordinatez pointz posz positionz zpos zposition points2 coords2 coordinates2",
    "height elevation elev altitude alt ellipsoidalheight orthometricheight up",
    "h u",
};

static const char *const colours[][3] = {
    {"red", "green", "blue"},
    {"r", "g", "b"},
    {"rf", "gf", "bf"},
    {"colorr colourr colorred colourred", "colorg colourg colorgreen colourgreen",
     "colorb colourb colorblue colourblue"},
    {"rgb0", "rgb1", "rgb2"},
    {"diffusered", "diffusegreen", "diffuseblue"},
};

static const char *const normals[][3] = {
    {"nx", "ny", "nz"},
    {"normalx", "normaly", "normalz"},
    {"normalsx", "normalsy", "normalsz"},
    {"normals0", "normals1", "normals2"},
    {"normal0", "normal1", "normal2"},
};

static const char alphas[] = "alpha a colora coloura coloralpha diffusealpha";

/* Units that may stand behind "_". */
static const char units[] = "m mm cm dm km um nm ft in deg rad meter meters metre metres feet degree degrees";

/* ------------------------------------------------------------------------------------------------ one name */

/* Whether word is among those of a row. */
static bool is_among(const char *row, const char *word, size_t n) {
    for (const char *at = row; *at;) {
        size_t length = strcspn(at, " ");
        if (length == n && memcmp(at, word, n) == 0) return true;
        at += length + (at[length] == ' ');
    }
    return false;
}

/* The word without a unit in brackets at its end. */
static size_t without_brackets(const char *text, size_t n) {
    if (n < 2 || (text[n - 1] != ']' && text[n - 1] != ')')) return n;
    size_t at = n - 1;
    while (at > 0 && text[at] != '[' && text[at] != '(') at--;
    while (at > 0 && (scan_is_blank(text[at - 1]) || text[at - 1] == '_')) at--;
    return at ? at : n;
}

static size_t without_unit(const char *text, size_t n) {
    size_t at = n;
    while (at > 0 && text[at - 1] != '_') at--;
    return at > 1 && is_among(units, text + at, n - at) ? at - 1 : n;
}

/* Letters and digits of the name alone, in small letters; "" where it is longer than any known one. */
static void make_plain(const struct scan_word *name, char plain[PLAIN_BYTES]) {
    char lower[2 * PLAIN_BYTES];
    size_t n = without_brackets(name->text, name->n), used = 0;
    plain[0] = 0;
    if (n > sizeof lower) return;
    for (size_t i = 0; i < n; i++) lower[i] = (char)tolower((unsigned char)name->text[i]);
    n = without_unit(lower, n);
    for (size_t i = 0; i < n; i++) {
        if (strchr(" \t_-.:,;", lower[i]) && lower[i]) continue;
        if (used + 1 == PLAIN_BYTES) {
            plain[0] = 0;
            return;
        }
        plain[used++] = lower[i];
    }
    plain[used] = 0;
}

/* ------------------------------------------------------------------------------------------------ all names */

struct search {
    size_t count;
    char plain[CLOUD_MAX_PROPERTIES][PLAIN_BYTES];
    struct column_names *names;
};

/* The first column without a meaning so far whose name is in the row; search->count: there is none. */
static size_t find_first(const struct search *search, const char *row) {
    size_t j = 0;
    while (j < search->count && (search->names->meaning[j] || !search->plain[j][0] ||
                                 !is_among(row, search->plain[j], strlen(search->plain[j]))))
        j++;
    return j;
}

static void find_xyz_names(struct search *search) {
    size_t x = search->count, y = x, z = x, none = x, row = 0;
    for (; row < sizeof planes / sizeof *planes; row++) {
        x = find_first(search, planes[row][0]);
        y = find_first(search, planes[row][1]);
        if (x < none && y < none) break;
    }
    for (size_t i = 0; i < sizeof heights / sizeof *heights && z == none; i++) z = find_first(search, heights[i]);
    if (x == none || y == none || z == none) return;
    search->names->meaning[x] = "x", search->names->meaning[y] = "y", search->names->meaning[z] = "z";
    search->names->has_xyz = true;
    search->names->is_geographic = row == GEOGRAPHIC;
}

/* Gives three columns their meanings by the first row that has names for all. */
static bool find_three(struct search *search, const char *const rows[][3], size_t count, const char *const meaning[3]) {
    for (size_t row = 0; row < count; row++) {
        size_t found[3];
        for (int k = 0; k < 3; k++) found[k] = find_first(search, rows[row][k]);
        if (found[0] == search->count || found[1] == search->count || found[2] == search->count) continue;
        for (int k = 0; k < 3; k++) search->names->meaning[found[k]] = meaning[k];
        return true;
    }
    return false;
}

static void find_meanings(struct column_names *names) {
    static const char *const colour[] = {"red", "green", "blue"}, *const normal[] = {"nx", "ny", "nz"};
    struct search search = {.names = names};
    search.count = names->count < CLOUD_MAX_PROPERTIES ? names->count : CLOUD_MAX_PROPERTIES;
    for (size_t j = 0; j < search.count; j++) make_plain(&names->name[j], search.plain[j]);
    find_xyz_names(&search);
    (void)find_three(&search, normals, sizeof normals / sizeof *normals, normal);
    if (!find_three(&search, colours, sizeof colours / sizeof *colours, colour)) return;
    size_t alpha = find_first(&search, alphas);
    if (alpha < search.count) names->meaning[alpha] = "alpha";
}

/* ------------------------------------------------------------------------------------------------ a line */

/* What separates the names; 0 = blanks. */
static char mark_of(const char *at, const char *end) {
    static const char marks[] = ",;\t";
    for (const char *mark = marks; *mark; mark++)
        for (const char *c = at; c < end && !scan_is_newline(*c); c++)
            if (*c == *mark) return *mark;
    return 0;
}

/* The next name at *at, which is moved past it; false at the line's end. */
static bool next_name(const char **at, const char *end, char mark, const char **from, const char **stop) {
    if (!mark) {
        do {
            while (*at < end && scan_is_blank(**at)) ++*at;
            for (*from = *at; *at < end && !scan_is_blank(**at) && !scan_is_newline(**at);) ++*at;
            *stop = *at;
            if (*stop == *from) return false;
        } while (scan_is_bracketed(*from, *stop));
    } else {
        if (*at == end || scan_is_newline(**at)) return false;
        for (*from = *at; *at < end && **at != mark && !scan_is_newline(**at);) ++*at;
        *stop = *at;
        if (*at < end && **at == mark) ++*at;
    }
    while (*from < *stop && (scan_is_blank(**from) || scan_is_quote(**from))) ++*from;
    while (*from < *stop && (scan_is_blank((*stop)[-1]) || scan_is_quote((*stop)[-1]))) --*stop;
    return true;
}

void column_names_split(const char *at, const char *end, struct column_names *names) {
    char mark = mark_of(at, end);
    names->count = 0;
    memset(names->meaning, 0, sizeof names->meaning);
    names->has_xyz = names->is_geographic = false;
    for (const char *from, *stop; next_name(&at, end, mark, &from, &stop); names->count++)
        if (names->count < CLOUD_MAX_PROPERTIES)
            names->name[names->count] = (struct scan_word){from, (size_t)(stop - from)};
    find_meanings(names);
}

size_t column_names_find(const struct column_names *names, const char *text, size_t n) {
    size_t kept = names->count < CLOUD_MAX_PROPERTIES ? names->count : CLOUD_MAX_PROPERTIES;
    for (size_t j = 0; j < kept; j++)
        if (names->name[j].n == n && memcmp(names->name[j].text, text, n) == 0) return j;
    for (size_t j = 0; j < kept; j++)
        if (names->name[j].n == n && strncasecmp(names->name[j].text, text, n) == 0) return j;
    return names->count;
}
