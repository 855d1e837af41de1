/* Letters are strokes on a grid: each stroke is places of two figures, x from 0 and y from 0 at the top of a digit to a
 * at the line that letters stand on; small letters begin at 4 and end at d.  They are drawn as round pens do.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/picture/lettering.h"

#include <math.h>
#include <stdbool.h>

static const double GRID = 10, PEN = 1.15, BETWEEN = 2.1, GAP = 4; /* of the grid: a digit's height; widths */

static const struct letter {
    char sign;
    const char *strokes;
} letters[] = {
    {'0', "204062684a2a080220"},
    {'1', "12303a"},
    {'2', "02204062640a6a"},
    {'3', "02204062634525 4567684a2a08"},
    {'4', "5a500777"},
    {'5', "601005244466684a2a08"},
    {'6', "51402002082a4a6866442406"},
    {'7', "00602a"},
    {'8', "204062634525030220 254567684a2a080725"},
    {'9', "192a4a686240200204264664"},
    {'a', "152444555a 572708091a3a58"},
    {'b', "000a 06243456583a2a08"},
    {'c', "55442406082a4a59"},
    {'d', "505a 56342406082a3a58"},
    {'e', "075756342406082a3a59"},
    {'f', "4030121a 0444"},
    {'g', "56342406082a3a58 545b3d1d0c"},
    {'h', "000a 062434565a"},
    {'i', "141a 1111"},
    {'j', "242b1d0d 2121"},
    {'k', "000a 4408 264a"},
    {'l', "000a"},
    {'m', "040a 061424363a 364454666a"},
    {'n', "040a 062434565a"},
    {'o', "243456583a2a080624"},
    {'p', "040d 06243456583a2a08"},
    {'q', "545d 56342406082a3a58"},
    {'r', "040a 062444"},
    {'s', "4534140506173748493a1a09"},
    {'t', "11192a3a 0434"},
    {'u', "04082a3a58 545a"},
    {'v', "042a44"},
    {'w', "041a355a64"},
    {'x', "044a 440a"},
    {'y', "042a 442a1d0d"},
    {'z', "04440a4a"},
    {'.', "0a0a"},
    {',', "1a0c"},
    {'-', "0747"},
    {'+', "0747 2529"},
    {'/', "400c"},
    {'%', "600a 1021120110 58695a4958"},
    {'>', "04470a"},
    {'<', "44074a"},
    {'=', "0646 0949"},
    {':', "0505 0a0a"},
};

static int figure(char c) { return c >= 'a' ? c - 'a' + 10 : c - '0'; }

static const char *strokes_of(char sign) {
    for (size_t i = 0; i < sizeof letters / sizeof *letters; i++)
        if (letters[i].sign == sign) return letters[i].strokes;
    return NULL;
}

static double width_of(const char *strokes) {
    int widest = 0, place = 0;
    for (const char *c = strokes; *c; c++) {
        if (*c == ' ') continue;
        if (place++ % 2 == 0 && figure(*c) > widest) widest = figure(*c);
    }
    return widest;
}

double lettering_width(const char *text, double height) {
    double wide = 0;
    for (const char *c = text; *c; c++) {
        const char *strokes = strokes_of(*c);
        wide += strokes ? width_of(strokes) + BETWEEN : GAP;
    }
    return wide * height / GRID;
}

/* Distance from a place to a line between two others. */
static double distance_to(double px, double py, double ax, double ay, double bx, double by) {
    double ux = bx - ax, uy = by - ay, along = ux * ux + uy * uy;
    double t = along > 0 ? fmin(fmax(((px - ax) * ux + (py - ay) * uy) / along, 0), 1) : 0;
    double dx = px - ax - t * ux, dy = py - ay - t * uy;
    return sqrt(dx * dx + dy * dy);
}

void lettering_line(struct picture *picture, double ax, double ay, double bx, double by, double width,
                    const unsigned char colour[3]) {
    double reach = width / 2 + 1;
    double left = fmax(floor(fmin(ax, bx) - reach), 0),
           right = fmin(ceil(fmax(ax, bx) + reach), (double)picture->width);
    double top = fmax(floor(fmin(ay, by) - reach), 0),
           bottom = fmin(ceil(fmax(ay, by) + reach), (double)picture->height);
    for (double y = top; y < bottom; y++)
        for (double x = left; x < right; x++) {
            double cover = fmin(fmax(width / 2 + 0.5 - distance_to(x + 0.5, y + 0.5, ax, ay, bx, by), 0), 1);
            unsigned char *to = &picture->rgb[3 * ((size_t)y * picture->width + (size_t)x)];
            for (int c = 0; c < 3; c++) to[c] = (unsigned char)(to[c] + cover * (colour[c] - to[c]) + 0.5);
        }
}

static void write_sign(struct picture *picture, double x, double y, double unit, const unsigned char colour[3],
                       const char *strokes) {
    double from_x = 0, from_y = 0;
    bool joined = false;
    for (const char *c = strokes; *c; joined = true) {
        if (*c == ' ') {
            joined = false;
            c++;
        }
        double to_x = x + figure(c[0]) * unit, to_y = y + (figure(c[1]) - GRID) * unit;
        if (joined) lettering_line(picture, from_x, from_y, to_x, to_y, PEN * unit, colour);
        from_x = to_x, from_y = to_y;
        c += 2;
    }
}

void lettering_write(struct picture *picture, double x, double y, double height, const unsigned char colour[3],
                     const char *text) {
    double unit = height / GRID;
    for (const char *c = text; *c; c++) {
        const char *strokes = strokes_of(*c);
        if (strokes) write_sign(picture, x, y, unit, colour, strokes);
        x += (strokes ? width_of(strokes) + BETWEEN : GAP) * unit;
    }
}
