/* libpng jumps where it fails, so all that it fails in is one function that owns nothing but what libpng keeps for it.
 * It gets memory from core/base/alloc.h.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/picture/png_write.h"

#include <png.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/io/out/sink.h"

static void *take_memory(png_structp png, png_alloc_size_t bytes) {
    (void)png;
    return alloc_array(bytes, 1);
}

static void free_memory(png_structp png, void *memory) {
    (void)png;
    free(memory);
}

static void put_bytes(png_structp png, png_bytep bytes, size_t n) { sink_bytes(png_get_io_ptr(png), bytes, n); }

static void put_nothing(png_structp png) { (void)png; }

static void fail(png_structp png, const char *text) {
    (void)text;
    png_longjmp(png, 1);
}

static void ignore(png_structp png, const char *text) { (void)png, (void)text; }

/* false where memory ran out. */
static bool put_picture(png_structp png, png_infop info, const struct picture *picture) {
    if (setjmp(png_jmpbuf(png))) return false;
    png_set_IHDR(png, info, (png_uint_32)picture->width, (png_uint_32)picture->height, 8, PNG_COLOR_TYPE_RGB,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_set_sRGB(png, info, PNG_sRGB_INTENT_PERCEPTUAL);
    png_write_info(png, info);
    for (size_t y = 0; y < picture->height; y++) png_write_row(png, &picture->rgb[3 * y * picture->width]);
    png_write_end(png, NULL);
    return true;
}

static void free_writer(png_structp png, png_infop info) { png_destroy_write_struct(&png, &info); }

enum status picture_write_png(int fd, const struct picture *picture, struct error *error) {
    struct sink sink;
    enum status status = sink_init(&sink, fd);
    png_structp png =
        png_create_write_struct_2(PNG_LIBPNG_VER_STRING, NULL, fail, ignore, NULL, take_memory, free_memory);
    png_infop info = png ? png_create_info_struct(png) : NULL;
    if (info) png_set_write_fn(png, &sink, put_bytes, put_nothing);
    if (!status && (!info || !put_picture(png, info, picture))) status = STATUS_NO_MEMORY;
    if (png) free_writer(png, info);
    if (status) error_set(error, status, "preview.png", "no memory for the picture");
    return sink_done(&sink, status, error);
}
