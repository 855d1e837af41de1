/* Items of points in layers: formats 6 to 10.
 *
 * Each attribute of all points of a chunk is a code of its own, so that a reader may skip what it doesn't want, and one
 * that never changes takes no byte.  Everything is predicted within one of four contexts, the scanner's channel; one
 * that is met for the first time begins with the last point of the one before.
 *
 * Invariant: `now` is the channel of the last point; whatever follows the point's own item takes it from there.
 *
 * Version 3 of colours, waveforms and bytes has a slip that is part of the format by now: the first point after a
 * change to a channel that was there before is predicted from, and kept as, the last point of the *other* channel.
 * Version 4 doesn't.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/io/laz/items.h"

/* Layers of a point's own item, in their order; those of other items follow. */
enum { XY, Z, CLASS, FLAGS, INTENSITY, ANGLE, USER, SOURCE, TIME, POINT_LAYERS };
enum { CHANNELS = 4, KINDS = 6, LEVELS = 8, Y_CONTEXT = 20, Z_CONTEXT = 18, NIR_MODELS = 2, COLOURS = 4 };

/* By number of returns and number of the return. */
static const uint8_t return_kind[16][16] = {
    {0, 1, 2, 3, 4, 5, 3, 4, 4, 5, 5, 5, 5, 5, 5, 5}, {1, 0, 1, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3},
    {2, 1, 2, 4, 4, 4, 4, 4, 4, 4, 4, 3, 3, 3, 3, 3}, {3, 3, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4},
    {4, 3, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4}, {5, 3, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4},
    {3, 3, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4}, {4, 3, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4},
    {4, 3, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4}, {5, 3, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4},
    {5, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4}, {5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 4, 4, 4},
    {5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4, 4}, {5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4},
    {5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5}, {5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5},
};

struct layer {
    struct laz_coder coder;
    struct laz_bytes out; /* writing; owned */
    bool there;           /* reading: it has bytes; writing: true */
    bool changed;         /* writing: somewhere */
};

/* A point's 30 bytes. */
struct point14 {
    uint32_t x, y, z, intensity, number, of, flags, channel, class, user, angle, source;
    uint64_t time;
    bool time_changed; /* from the point before it */
};

struct channel {
    bool met;
    struct point14 last;
    uint32_t last_intensity[8], last_z[LEVELS];
    struct laz_median step_x[2 * KINDS], step_y[2 * KINDS];
    struct laz_model changed[8], channel, of[16], number[16], number_same_time, class[64], flags[64], user[64];
    struct laz_integer dx, dy, z, intensity, angle, source;
    struct laz_time time;
};

/* What other items keep for each channel. */
struct colour {
    bool met;
    uint16_t last[COLOURS];
    struct laz_rgb rgb;
    struct laz_model nir_used, nir[NIR_MODELS];
};

struct wave {
    bool met;
    struct laz_wave wave;
};

struct extra {
    bool met;
    unsigned char *last;    /* a part of laz_layered.last_byte */
    struct laz_model *byte; /* a part of laz_layered.byte */
};

struct laz_layered {
    struct laz_layout layout;
    size_t layers, extras;
    unsigned now, shared, colour_now, wave_now, extra_now; /* channels */
    struct channel channel[CHANNELS];
    struct colour colour[CHANNELS];
    struct wave wave[CHANNELS];
    struct extra extra[CHANNELS];
    unsigned char *last_byte; /* CHANNELS * extras; owned */
    struct laz_model *byte;   /* likewise */
    struct layer *layer;      /* layers; owned */
    uint16_t *data;           /* of all models; owned */
};

size_t laz_layers(const struct laz_layout *layout) {
    size_t layers = 0;
    for (size_t i = 0; i < layout->item_count; i++) {
        const struct laz_item *item = &layout->item[i];
        layers += item->type == LAZ_POINT14    ? POINT_LAYERS
                  : item->type == LAZ_RGBNIR14 ? 2
                  : item->type == LAZ_BYTES14  ? item->bytes
                                               : 1;
    }
    return layers;
}

/* ------------------------------------------------------------------------------------------------ POINT14 */

/* Bits of the symbol that tells what changed; the lowest two tell how the number of the return did. */
enum { OTHER_CHANNEL = 64, OTHER_SOURCE = 32, OTHER_TIME = 16, OTHER_ANGLE = 8, OTHER_OF = 4 };
enum { NUMBER_SAME, NUMBER_NEXT, NUMBER_BEFORE, NUMBER_ANY, NUMBER = 3 };
enum { EDGE = 32, DIRECTION = 16 };

static struct point14 load_point14(const unsigned char *p) {
    return (struct point14){.x = laz_load32(p),
                            .y = laz_load32(p + 4),
                            .z = laz_load32(p + 8),
                            .intensity = laz_load16(p + 12),
                            .number = p[14] & 15,
                            .of = p[14] >> 4,
                            .flags = (p[15] & 15) | (p[15] & 0x40 ? DIRECTION : 0) | (p[15] & 0x80 ? EDGE : 0),
                            .channel = p[15] >> 4 & 3,
                            .class = p[16],
                            .user = p[17],
                            .angle = laz_load16(p + 18),
                            .source = laz_load16(p + 20),
                            .time = laz_load64(p + 22)};
}

static void store_point14(unsigned char *p, const struct point14 *point) {
    laz_store32(p, point->x);
    laz_store32(p + 4, point->y);
    laz_store32(p + 8, point->z);
    laz_store16(p + 12, point->intensity);
    p[14] = (unsigned char)(point->number | point->of << 4);
    p[15] = (unsigned char)((point->flags & 15) | point->channel << 4 | (point->flags & DIRECTION ? 0x40 : 0) |
                            (point->flags & EDGE ? 0x80 : 0));
    p[16] = (unsigned char)point->class;
    p[17] = (unsigned char)point->user;
    laz_store16(p + 18, point->angle);
    laz_store16(p + 20, point->source);
    laz_store64(p + 22, point->time);
}

static void begin_channel(struct channel *c, const struct point14 *first) {
    c->met = true;
    c->last = *first;
    c->last.time_changed = false;
    for (size_t i = 0; i < 8; i++) c->last_intensity[i] = first->intensity;
    for (size_t i = 0; i < LEVELS; i++) c->last_z[i] = first->z;
    memset(c->step_x, 0, sizeof c->step_x);
    memset(c->step_y, 0, sizeof c->step_y);
    laz_models_begin(c->changed, 8);
    laz_models_begin(&c->channel, 1);
    laz_models_begin(c->of, 16);
    laz_models_begin(c->number, 16);
    laz_models_begin(&c->number_same_time, 1);
    laz_models_begin(c->class, 64);
    laz_models_begin(c->flags, 64);
    laz_models_begin(c->user, 64);
    struct laz_integer *integers[] = {&c->dx, &c->dy, &c->z, &c->intensity, &c->angle, &c->source};
    for (size_t i = 0; i < sizeof integers / sizeof *integers; i++) laz_integer_begin(integers[i]);
    laz_time_begin(&c->time, first->time);
}

static uint32_t layered_changes_of(const struct point14 *last, const struct point14 *point, bool other_channel) {
    uint32_t step = (point->number - last->number) & 15;
    uint32_t number = step == 0 ? NUMBER_SAME : step == 1 ? NUMBER_NEXT : step == 15 ? NUMBER_BEFORE : NUMBER_ANY;
    return number | (other_channel ? OTHER_CHANNEL : 0) | (point->source != last->source ? OTHER_SOURCE : 0) |
           (point->time != last->time ? OTHER_TIME : 0) | (point->angle != last->angle ? OTHER_ANGLE : 0) |
           (point->of != last->of ? OTHER_OF : 0);
}

/* What changed, which channel, and which return of how many. */
LAZ_CODES uint32_t code_returns(struct laz_layered *l, struct point14 *point, const bool write) {
    struct laz_coder *coder = &l->layer[XY].coder;
    struct channel *c = &l->channel[l->now], *next = c;
    const struct point14 *last = &c->last;
    size_t context = (last->number == 1) + (last->number >= last->of ? 2u : 0) + (last->time_changed ? 4u : 0);
    uint32_t changed = 0;
    if (write) {
        if (l->channel[point->channel].met) last = &l->channel[point->channel].last;
        changed = layered_changes_of(last, point, point->channel != l->now);
    }
    changed = laz_code_symbol(coder, &c->changed[context], changed, write);
    if (changed & OTHER_CHANNEL) {
        uint32_t step = laz_code_symbol(coder, &c->channel, (point->channel - l->now - 1) & 3, write);
        l->now = (l->now + step + 1) & 3;
        next = &l->channel[l->now];
        if (!next->met) begin_channel(next, &c->last);
        next->last.channel = l->now;
    }
    l->shared = changed & OTHER_CHANNEL || l->layout.item[0].version >= 4 ? l->now : 0;
    last = &next->last;
    uint32_t of = last->of, number = last->number;
    if (changed & OTHER_OF) of = laz_code_symbol(coder, &next->of[last->of], point->of, write);
    if ((changed & NUMBER) == NUMBER_NEXT) number = (number + 1) & 15;
    if ((changed & NUMBER) == NUMBER_BEFORE) number = (number - 1) & 15;
    if ((changed & NUMBER) == NUMBER_ANY) {
        if (changed & OTHER_TIME)
            number = laz_code_symbol(coder, &next->number[last->number], point->number, write);
        else
            number = (number + 2 +
                      laz_code_symbol(coder, &next->number_same_time, (point->number - number - 2) & 15, write)) &
                     15;
    }
    point->of = next->last.of = of;
    point->number = next->last.number = number;
    point->channel = l->now;
    return changed;
}

/* A symbol in a layer of its own; what it was where the layer isn't there. */
LAZ_CODES uint32_t code_apart(struct layer *layer, struct laz_model *model, uint32_t last, uint32_t value,
                              const bool write) {
    if (!write && !layer->there) return last;
    value = laz_code_symbol(&layer->coder, model, value, write);
    layer->changed |= value != last;
    return value;
}

LAZ_CODES void code_point14(struct laz_layered *l, unsigned char *item, const bool write) {
    struct point14 point = {0}, *last;
    if (write) point = load_point14(item);
    uint32_t changed = code_returns(l, &point, write);
    struct channel *c = &l->channel[l->now];
    struct layer *layer = l->layer;
    bool time_changed = changed & OTHER_TIME, first = point.number == 1, is_last = point.number >= point.of;
    uint32_t level = point.number > point.of ? point.number - point.of : point.of - point.number;
    size_t kind = (size_t)return_kind[point.of][point.number] << 1 | time_changed, single = point.of == 1;
    size_t place = (first ? 2u : 0) + is_last;
    last = &c->last;
    if (level > 7) level = 7;

    uint32_t step = laz_code_integer(&layer[XY].coder, &c->dx, (uint32_t)c->step_x[kind].value[2], single,
                                     point.x - last->x, write);
    laz_median_add(&c->step_x[kind], (int32_t)step);
    last->x += step;
    step = laz_code_integer(&layer[XY].coder, &c->dy, (uint32_t)c->step_y[kind].value[2],
                            single + laz_size_context(c->dx.k, Y_CONTEXT), point.y - last->y, write);
    laz_median_add(&c->step_y[kind], (int32_t)step);
    last->y += step;
    if (layer[Z].there)
        last->z = c->last_z[level] =
            laz_code_integer(&layer[Z].coder, &c->z, c->last_z[level],
                             single + laz_size_context((c->dx.k + c->dy.k) / 2, Z_CONTEXT), point.z, write);
    last->class =
        code_apart(&layer[CLASS], &c->class[(last->class & 31) << 1 | (place == 3)], last -> class, point.class, write);
    last->flags = code_apart(&layer[FLAGS], &c->flags[last->flags], last->flags, point.flags, write);
    if (layer[INTENSITY].there) {
        uint32_t *before = &c->last_intensity[place << 1 | time_changed];
        uint32_t now = laz_code_integer(&layer[INTENSITY].coder, &c->intensity, *before, place, point.intensity, write);
        layer[INTENSITY].changed |= now != last->intensity;
        last->intensity = *before = now;
    }
    if (changed & OTHER_ANGLE && layer[ANGLE].there) {
        last->angle = laz_code_integer(&layer[ANGLE].coder, &c->angle, last->angle, time_changed, point.angle, write);
        layer[ANGLE].changed = true;
    }
    last->user = code_apart(&layer[USER], &c->user[last->user / 4], last->user, point.user, write);
    if (changed & OTHER_SOURCE && layer[SOURCE].there) {
        last->source = laz_code_integer(&layer[SOURCE].coder, &c->source, last->source, 0, point.source, write);
        layer[SOURCE].changed = true;
    }
    if (time_changed && layer[TIME].there) {
        last->time = laz_code_time(&layer[TIME].coder, &c->time, point.time, false, write);
        layer[TIME].changed = true;
    }
    last->time_changed = time_changed;
    if (!write) store_point14(item, last);
}

/* ------------------------------------------------------------------------------------------------ other items */

static void begin_colour(struct colour *c, const uint16_t last[COLOURS]) {
    for (size_t i = 0; i < COLOURS; i++) c->last[i] = last[i];
    laz_rgb_begin(&c->rgb);
    laz_models_begin(&c->nir_used, 1);
    laz_models_begin(c->nir, NIR_MODELS);
    c->met = true;
}

LAZ_CODES void code_colour14(struct laz_layered *l, const struct laz_item *about, struct layer *layer,
                             unsigned char *item, const bool write) {
    const size_t n = about->bytes / 2;
    struct colour *from = &l->colour[l->colour_now], *c = &l->colour[l->shared];
    uint16_t colour[COLOURS] = {0};
    l->colour_now = l->shared;
    if (!c->met) begin_colour(c, from->last), from = c;
    uint16_t *last = about->version < 4 ? from->last : c->last;
    memcpy(colour, last, sizeof colour);
    for (size_t i = 0; write && i < n; i++) colour[i] = (uint16_t)laz_load16(item + 2 * i);
    layer[0].changed |= memcmp(colour, last, 6) != 0;
    if (layer[0].there) laz_code_rgb(&layer[0].coder, &c->rgb, last, colour, write);
    if (n == COLOURS && layer[1].there) {
        uint32_t before = last[3], now = colour[3];
        uint32_t used = ((now ^ before) & 0xff ? 1 : 0) | ((now ^ before) >> 8 ? 2 : 0), low = before & 0xff;
        uint32_t high = before >> 8;
        layer[1].changed |= now != before;
        used = laz_code_symbol(&layer[1].coder, &c->nir_used, used, write);
        if (used & 1) low = laz_code_byte(&layer[1].coder, &c->nir[0], low, now & 0xff, write);
        if (used & 2) high = laz_code_byte(&layer[1].coder, &c->nir[1], high, now >> 8, write);
        colour[3] = (uint16_t)(low | high << 8);
    }
    memcpy(last, colour, sizeof colour);
    for (size_t i = 0; !write && i < n; i++) laz_store16(item + 2 * i, colour[i]);
}

LAZ_CODES void code_wave14(struct laz_layered *l, const struct laz_item *about, struct layer *layer,
                           unsigned char *item, const bool write) {
    struct wave *from = &l->wave[l->wave_now], *c = &l->wave[l->shared];
    l->wave_now = l->shared;
    if (!c->met) {
        laz_wave_begin(&c->wave, from->wave.last);
        c->met = true;
        from = c;
    }
    unsigned char *last = about->version < 4 ? from->wave.last : c->wave.last;
    layer->changed |= write && memcmp(last, item, LAZ_WAVE_BYTES) != 0;
    if (!write && !layer->there)
        memcpy(item, last, LAZ_WAVE_BYTES);
    else
        laz_code_wave(&layer->coder, &c->wave, last, item, write);
    memcpy(last, item, LAZ_WAVE_BYTES);
}

static void begin_extra(const struct laz_layered *l, struct extra *c, const unsigned char *last) {
    for (size_t i = 0; i < l->extras; i++) c->last[i] = last[i];
    laz_models_begin(c->byte, l->extras);
    c->met = true;
}

LAZ_CODES void code_bytes14(struct laz_layered *l, const struct laz_item *about, struct layer *layer,
                            unsigned char *item, const bool write) {
    struct extra *from = &l->extra[l->extra_now], *c = &l->extra[l->shared];
    l->extra_now = l->shared;
    if (!c->met) begin_extra(l, c, from->last), from = c;
    unsigned char *last = about->version < 4 ? from->last : c->last;
    for (size_t i = 0; i < l->extras; i++) {
        layer[i].changed |= write && item[i] != last[i];
        if (layer[i].there)
            last[i] = (unsigned char)laz_code_byte(&layer[i].coder, &c->byte[i], last[i], item[i], write);
        if (!write) item[i] = last[i];
    }
}

LAZ_CODES void code_layers(struct laz_layered *l, unsigned char *record, const bool write) {
    struct layer *layer = l->layer;
    for (size_t i = 0; i < l->layout.item_count; i++) {
        const struct laz_item *about = &l->layout.item[i];
        unsigned char *item = record + about->offset;
        switch (about->type) {
        case LAZ_POINT14:
            code_point14(l, item, write);
            layer += POINT_LAYERS;
            break;
        case LAZ_RGB14:
            code_colour14(l, about, layer, item, write);
            layer += 1;
            break;
        case LAZ_RGBNIR14:
            code_colour14(l, about, layer, item, write);
            layer += 2;
            break;
        case LAZ_WAVE14:
            code_wave14(l, about, layer, item, write);
            layer += 1;
            break;
        default: code_bytes14(l, about, layer, item, write); break;
        }
    }
}

void laz_layered_read(struct laz_layered *layered, unsigned char *record) { code_layers(layered, record, false); }

void laz_layered_write(struct laz_layered *layered, const unsigned char *record) {
    unsigned char copy[LAZ_RECORD_MOST];
    memcpy(copy, record, layered->layout.record_bytes);
    code_layers(layered, copy, true);
}

/* ------------------------------------------------------------------------------------------------ layers */

void laz_layered_read_layer(struct laz_layered *layered, size_t layer, const unsigned char *bytes, size_t n) {
    layered->layer[layer].there = n > 0;
    layered->layer[layer].coder = n > 0 ? laz_coder_read(bytes, n) : (struct laz_coder){0};
}

const struct laz_coder *laz_layered_coder(const struct laz_layered *layered, size_t layer) {
    return &layered->layer[layer].coder;
}

void laz_layered_begin(struct laz_layered *l, const unsigned char *first) {
    unsigned now = load_point14(first).channel;
    l->now = l->colour_now = l->wave_now = l->extra_now = now;
    for (unsigned i = 0; i < CHANNELS; i++)
        l->channel[i].met = l->colour[i].met = l->wave[i].met = l->extra[i].met = false;
    for (size_t i = 0; i < l->layout.item_count; i++) {
        const unsigned char *item = first + l->layout.item[i].offset;
        uint16_t colour[COLOURS] = {0};
        const struct point14 point = load_point14(first);
        switch (l->layout.item[i].type) {
        case LAZ_POINT14: begin_channel(&l->channel[now], &point); break;
        case LAZ_RGB14:
        case LAZ_RGBNIR14:
            for (size_t k = 0; k < l->layout.item[i].bytes / 2; k++) colour[k] = (uint16_t)laz_load16(item + 2 * k);
            begin_colour(&l->colour[now], colour);
            break;
        case LAZ_WAVE14:
            laz_wave_begin(&l->wave[now].wave, item);
            l->wave[now].met = true;
            break;
        default: begin_extra(l, &l->extra[now], item);
        }
    }
    for (size_t i = 0; i < l->layers; i++) { /* for writing; a reader sets its own after this */
        l->layer[i].out.used = 0;
        l->layer[i].coder = laz_coder_write(&l->layer[i].out);
        l->layer[i].there = true;
        l->layer[i].changed = i == XY || i == Z;
    }
}

void laz_layered_finish(struct laz_layered *l, struct laz_bytes *out) {
    for (size_t i = 0; i < l->layers; i++) {
        struct layer *layer = &l->layer[i];
        if (layer->changed) laz_coder_finish(&layer->coder);
        out->failed |= layer->out.failed || layer->out.used > UINT32_MAX;
        laz_put_number(out, layer->changed ? layer->out.used : 0, 4);
    }
    for (size_t i = 0; i < l->layers; i++)
        if (l->layer[i].changed) laz_put(out, l->layer[i].out.bytes, l->layer[i].out.used);
}

/* ------------------------------------------------------------------------------------------------ models */

static void lay_channel(struct channel *c, struct laz_room *room) {
    laz_models_lay(c->changed, 8, 128, room);
    laz_model_lay(&c->channel, 3, room);
    laz_models_lay(c->of, 16, 16, room);
    laz_models_lay(c->number, 16, 16, room);
    laz_model_lay(&c->number_same_time, 13, room);
    laz_models_lay(c->class, 64, 256, room);
    laz_models_lay(c->flags, 64, 64, room);
    laz_models_lay(c->user, 64, 256, room);
    laz_integer_lay(&c->dx, 32, 2, room);
    laz_integer_lay(&c->dy, 32, 22, room);
    laz_integer_lay(&c->z, 32, 20, room);
    laz_integer_lay(&c->intensity, 16, 4, room);
    laz_integer_lay(&c->angle, 16, 2, room);
    laz_integer_lay(&c->source, 16, 1, room);
    laz_time_lay(&c->time, false, room);
}

static void lay_layered(struct laz_layered *l, struct laz_room *room) {
    for (size_t k = 0; k < CHANNELS; k++)
        for (size_t i = 0; i < l->layout.item_count; i++) switch (l->layout.item[i].type) {
            case LAZ_POINT14: lay_channel(&l->channel[k], room); break;
            case LAZ_RGB14:
            case LAZ_RGBNIR14:
                laz_rgb_lay(&l->colour[k].rgb, room);
                laz_model_lay(&l->colour[k].nir_used, 4, room);
                laz_models_lay(l->colour[k].nir, NIR_MODELS, 256, room);
                break;
            case LAZ_WAVE14: laz_wave_lay(&l->wave[k].wave, room); break;
            default:
                l->extra[k].last = l->last_byte + k * l->extras;
                l->extra[k].byte = l->byte + k * l->extras;
                laz_models_lay(l->extra[k].byte, l->extras, 256, room);
            }
}

struct laz_layered *laz_layered_new(const struct laz_layout *layout) {
    struct laz_layered *l = alloc_zeroed(1, sizeof *l);
    struct laz_room room = {0};
    if (!l) return NULL;
    const struct laz_item *last = &layout->item[layout->item_count - 1];
    l->layout = *layout;
    l->layers = laz_layers(layout);
    l->extras = last->type == LAZ_BYTES14 ? last->bytes : 0;
    l->last_byte = alloc_array(CHANNELS * l->extras, 1);
    l->byte = alloc_array(CHANNELS * l->extras, sizeof *l->byte);
    l->layer = alloc_zeroed(l->layers, sizeof *l->layer);
    if (l->last_byte && l->byte) lay_layered(l, &room);
    room.data = alloc_array(room.used, sizeof *room.data);
    room.used = 0;
    l->data = room.data;
    if (l->last_byte && l->byte && l->layer && l->data) {
        lay_layered(l, &room);
        return l;
    }
    laz_layered_free(l);
    return NULL;
}

void laz_layered_free(struct laz_layered *layered) {
    if (!layered) return;
    for (size_t i = 0; layered->layer && i < layered->layers; i++) free(layered->layer[i].out.bytes);
    free(layered->last_byte), free(layered->byte), free(layered->layer), free(layered->data);
    free(layered);
}
