/* Parts that several items of LAZ share: how their models are laid out and begun.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/laz/items.h"

#include <string.h>

void laz_models_begin(struct laz_model *model, size_t n) {
    for (size_t i = 0; i < n; i++) model[i].left = model[i].all = 0;
}

void laz_rgb_lay(struct laz_rgb *rgb, struct laz_room *room) {
    laz_model_lay(&rgb->used, 128, room);
    laz_models_lay(rgb->byte, 6, 256, room);
}

void laz_rgb_begin(struct laz_rgb *rgb) {
    laz_models_begin(&rgb->used, 1);
    laz_models_begin(rgb->byte, 6);
}

void laz_wave_lay(struct laz_wave *wave, struct laz_room *room) {
    laz_model_lay(&wave->index, 256, room);
    laz_models_lay(wave->step, 4, 4, room);
    laz_integer_lay(&wave->offset, 32, 1, room);
    laz_integer_lay(&wave->size, 32, 1, room);
    laz_integer_lay(&wave->location, 32, 1, room);
    laz_integer_lay(&wave->xyz, 32, 3, room);
}

void laz_wave_begin(struct laz_wave *wave, const unsigned char *first) {
    laz_models_begin(&wave->index, 1);
    laz_models_begin(wave->step, 4);
    laz_integer_begin(&wave->offset);
    laz_integer_begin(&wave->size);
    laz_integer_begin(&wave->location);
    laz_integer_begin(&wave->xyz);
    wave->last_step = wave->last_offset_step = 0;
    memcpy(wave->last, first, LAZ_WAVE_BYTES);
}

void laz_time_lay(struct laz_time *time, bool tells_same, struct laz_room *room) {
    laz_model_lay(&time->first_step, tells_same ? 6 : 5, room);
    laz_model_lay(&time->multiple, LAZ_TIME_MOST - LAZ_TIME_LEAST + (tells_same ? 6 : 5), room);
    laz_integer_lay(&time->step, 32, 9, room);
}

void laz_time_begin(struct laz_time *time, uint64_t first) {
    laz_models_begin(&time->first_step, 1);
    laz_models_begin(&time->multiple, 1);
    laz_integer_begin(&time->step);
    time->now = time->newest = 0;
    memset(time->last, 0, sizeof time->last);
    memset(time->last_step, 0, sizeof time->last_step);
    memset(time->extremes, 0, sizeof time->extremes);
    time->last[0] = first;
}
