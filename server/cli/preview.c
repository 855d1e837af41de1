/* Three ways to show a picture on a terminal.
 *
 *     kitty    the file itself, in base64, in pieces of 4096 letters between ESC _ G and ESC \
 *     sixel    bands of six rows: for each colour of a palette the pixels that have it, as letters from ? on
 *     blocks   two pixels for each place: the upper one as the colour of a half block, the lower one behind it
 *
 * Which one a terminal knows is read from the environment: asking the terminal itself would mean waiting for an answer
 * that many never give.
 *
 *     Kovid Goyal: The terminal graphics protocol.  Digital: VT330/VT340 Programmer Reference, volume 2, chapter 14.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/preview.h"

#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "core/picture/png_write.h"

enum { PIECE = 4096, USUAL_COLUMNS = 80, MOST_COLUMNS = 160, MOST_SIXELS = 1000 };
enum { REDS = 6, GREENS = 7, BLUES = 6, COLOURS = REDS * GREENS * BLUES, PAPER = COLOURS };

static const unsigned char paper[3] = {250, 250,
                                       248}; /* of core/picture; a colour of its own, so that it has no pattern */

enum view_up preview_up(const struct params *params, const struct cloud *cloud) {
    int up = params->up != UP_AUTO ? params->up : cloud->up;
    return up == UP_AUTO && cloud->count ? view_choose_up(cloud->position, cloud->count) : (enum view_up)up;
}

enum status preview_make(const struct params *params, const struct cloud *cloud, const struct pipeline_result *result,
                         struct picture *picture, struct error *error) {
    const struct pipeline_level *finest = &result->level[0];
    const struct report_level *figures = &result->report.level[0];
    const struct distance_stats *stats = figures->has_mesh ? &figures->input_to_mesh : &figures->tangent;
    const struct picture_scene scene = {.cloud = cloud,
                                        .normal = (const float(*)[3])result->facing,
                                        .deviation = result->distance,
                                        .mesh = &finest->mesh,
                                        .kept = result->kept,
                                        .kept_count = finest->kept_count,
                                        .mean = stats->mean,
                                        .largest = stats->max};
    const struct picture_view view = {(size_t)params->preview_size, params->preview_azimuth, params->preview_elevation,
                                      preview_up(params, cloud)};
    if (!picture_make(&scene, &view, (unsigned)params->threads, picture)) return STATUS_OK;
    return error_set(error, STATUS_NO_MEMORY, "preview.png", "no memory for the picture");
}

/* ------------------------------------------------------------------------------------------------ sizes */

/* The mean colour of the part of the picture that a pixel of a smaller one stands for. */
static void mean_colour(const struct picture *p, size_t x, size_t y, size_t width, size_t height,
                        unsigned char rgb[3]) {
    size_t left = x * p->width / width, right = (x + 1) * p->width / width;
    size_t top = y * p->height / height, bottom = (y + 1) * p->height / height;
    unsigned long sum[3] = {0}, n = 0;
    if (right == left) right++;
    if (bottom == top) bottom++;
    for (size_t j = top; j < bottom && j < p->height; j++)
        for (size_t i = left; i < right && i < p->width; i++, n++)
            for (int c = 0; c < 3; c++) sum[c] += p->rgb[3 * (j * p->width + i) + (size_t)c];
    for (int c = 0; c < 3; c++) rgb[c] = (unsigned char)(n ? sum[c] / n : 255);
}

/* width pixels wide; false where there is no memory. */
static bool shrink(const struct picture *picture, size_t width, struct picture *small) {
    size_t height = picture->height * width / picture->width;
    if (height < 2) height = 2;
    *small = (struct picture){width, height, malloc(3 * width * height)};
    for (size_t i = 0; small->rgb && i < width * height; i++)
        mean_colour(picture, i % width, i / width, width, height, &small->rgb[3 * i]);
    return small->rgb;
}

/* ------------------------------------------------------------------------------------------------ kitty */

static void put_base64(const unsigned char *bytes, size_t n, FILE *to) {
    static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    for (size_t i = 0; i < n; i += 3) {
        unsigned three =
            (unsigned)bytes[i] << 16 | (i + 1 < n ? (unsigned)bytes[i + 1] << 8 : 0) | (i + 2 < n ? bytes[i + 2] : 0u);
        fputc(letters[three >> 18], to);
        fputc(letters[three >> 12 & 63], to);
        fputc(i + 1 < n ? letters[three >> 6 & 63] : '=', to);
        fputc(i + 2 < n ? letters[three & 63] : '=', to);
    }
}

static bool show_kitty(const struct picture *picture, FILE *to) {
    unsigned char bytes[PIECE / 4 * 3];
    FILE *file = tmpfile();
    bool ok = file && !picture_write_png(fileno(file), picture, NULL) && fseek(file, 0, SEEK_END) == 0;
    long left = ok ? ftell(file) : 0;
    if (ok) rewind(file);
    for (bool first = true; left > 0; first = false) {
        size_t n = fread(bytes, 1, sizeof bytes, file);
        if (!n) break;
        left -= (long)n;
        fprintf(to, "\033_G%sm=%d;", first ? "a=T,f=100," : "", left > 0);
        put_base64(bytes, n, to);
        fputs("\033\\", to);
    }
    if (ok) fputc('\n', to);
    if (file) fclose(file);
    return ok;
}

/* ------------------------------------------------------------------------------------------------ sixel */

/* The palette's colour for a pixel; an ordered pattern makes what is between two of them a mixture. */
static unsigned palette_index(const unsigned char rgb[3], size_t x, size_t y) {
    static const unsigned char pattern[4][4] = {{0, 8, 2, 10}, {12, 4, 14, 6}, {3, 11, 1, 9}, {15, 7, 13, 5}};
    static const unsigned steps[3] = {REDS, GREENS, BLUES};
    if (memcmp(rgb, paper, sizeof paper) == 0) return PAPER;
    unsigned index = 0, between = pattern[y % 4][x % 4];
    for (int c = 0; c < 3; c++) index = index * steps[c] + (rgb[c] * (steps[c] - 1) * 16 / 255 + between) / 16;
    return index;
}

static void put_run(unsigned letter, size_t n, FILE *to) {
    if (n > 3)
        fprintf(to, "!%zu%c", n, (int)('?' + letter));
    else
        for (; n; n--) fputc((int)('?' + letter), to);
}

/* The pixels of one colour in six rows. */
static void put_band(const unsigned char *index, size_t width, size_t rows, unsigned colour, FILE *to) {
    unsigned before = 0;
    size_t n = 0;
    fprintf(to, "#%u", colour);
    for (size_t x = 0; x < width; x++) {
        unsigned bits = 0;
        for (size_t y = 0; y < rows; y++) bits |= (unsigned)(index[y * width + x] == colour) << y;
        if (bits != before) put_run(before, n, to), n = 0;
        before = bits;
        n++;
    }
    if (before) put_run(before, n, to);
}

static void put_sixels(const struct picture *p, unsigned char *index, FILE *to) {
    fprintf(to, "\033P0;1q\"1;1;%zu;%zu", p->width, p->height);
    for (unsigned i = 0; i < COLOURS; i++)
        fprintf(to, "#%u;2;%u;%u;%u", i, i / (GREENS * BLUES) * 100 / (REDS - 1),
                i / BLUES % GREENS * 100 / (GREENS - 1), i % BLUES * 100 / (BLUES - 1));
    fprintf(to, "#%d;2;98;98;97", PAPER);
    for (size_t top = 0; top < p->height; top += 6) {
        size_t rows = p->height - top < 6 ? p->height - top : 6;
        bool used[COLOURS + 1] = {false};
        for (size_t i = 0; i < rows * p->width; i++) {
            index[i] =
                (unsigned char)palette_index(&p->rgb[3 * (top * p->width + i)], i % p->width, top + i / p->width);
            used[index[i]] = true;
        }
        for (unsigned i = 0; i <= COLOURS; i++)
            if (used[i]) put_band(index, p->width, rows, i, to), fputc('$', to);
        fputc('-', to);
    }
    fputs("\033\\\n", to);
}

static bool show_sixel(const struct picture *picture, FILE *to) {
    struct picture small;
    bool ok = shrink(picture, picture->width < MOST_SIXELS ? picture->width : MOST_SIXELS, &small);
    unsigned char *index = ok ? malloc(6 * small.width) : NULL;
    if (index) put_sixels(&small, index, to);
    free(index);
    picture_done(&small);
    return index;
}

/* ------------------------------------------------------------------------------------------------ blocks */

static bool names(const char *variable, const char *part) {
    const char *value = getenv(variable);
    return value && strstr(value, part);
}

static void put_colour(int layer, const unsigned char rgb[3], bool exact, FILE *to) {
    if (exact)
        fprintf(to, "\033[%d;2;%u;%u;%um", layer, rgb[0], rgb[1], rgb[2]);
    else
        fprintf(to, "\033[%d;5;%um", layer,
                16 + 36 * (rgb[0] * 6u / 256) + 6 * (rgb[1] * 6u / 256) + rgb[2] * 6u / 256);
}

static size_t columns_of(FILE *to) {
    struct winsize size;
    if (ioctl(fileno(to), TIOCGWINSZ, &size) != 0 || !size.ws_col) return USUAL_COLUMNS;
    return size.ws_col < MOST_COLUMNS ? size.ws_col : MOST_COLUMNS;
}

static bool show_blocks(const struct picture *picture, FILE *to) {
    struct picture small;
    bool exact = names("COLORTERM", "truecolor") || names("COLORTERM", "24bit");
    if (!shrink(picture, columns_of(to), &small)) return false;
    for (size_t y = 0; y + 1 < small.height; y += 2) {
        for (size_t x = 0; x < small.width; x++) {
            put_colour(38, &small.rgb[3 * (y * small.width + x)], exact, to);
            put_colour(48, &small.rgb[3 * ((y + 1) * small.width + x)], exact, to);
            fputs("\xe2\x96\x80", to); /* the upper half block */
        }
        fputs("\033[0m\n", to);
    }
    picture_done(&small);
    return true;
}

/* ------------------------------------------------------------------------------------------------ the choice */

static enum preview_way guess(FILE *to) {
    if (!isatty(fileno(to)) || names("TERM", "dumb")) return PREVIEW_NOT;
    if (getenv("KITTY_WINDOW_ID") || names("TERM", "kitty") || names("TERM", "ghostty") ||
        names("TERM_PROGRAM", "WezTerm"))
        return PREVIEW_KITTY;
    if (names("TERM", "foot") || names("TERM", "mlterm") || names("TERM", "sixel")) return PREVIEW_SIXEL;
    bool utf8 = names("LC_ALL", "UTF-8") || names("LC_CTYPE", "UTF-8") || names("LANG", "UTF-8");
    return utf8 && getenv("TERM") ? PREVIEW_BLOCKS : PREVIEW_NOT;
}

bool preview_show(const struct picture *picture, enum preview_way way, FILE *to) {
    if (way == PREVIEW_AUTO) way = guess(to);
    switch (way) {
    case PREVIEW_KITTY: return show_kitty(picture, to);
    case PREVIEW_SIXEL: return show_sixel(picture, to);
    case PREVIEW_BLOCKS: return show_blocks(picture, to);
    case PREVIEW_AUTO:
    case PREVIEW_NOT: break;
    }
    return false;
}
