/* Fuzzes what the service believes of a job's process, which a hostile file may have taken over: its lines, in pieces
 * that the input chooses, and its report.
 *
 * However the lines are cut, the same messages come out; each is written and read again the same.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "api/codecs/report_read.h"
#include "server/shared/worker_protocol.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int condition) {
    if (!condition) abort();
}

struct seen {
    uint64_t hash;
    size_t messages;
};

static void hear(void *ctx, const struct wire_message *message) {
    struct seen *seen = ctx;
    struct wire_message again;
    char line[WIRE_LINE_BYTES], twice[WIRE_LINE_BYTES];
    size_t length = wire_encode(message, line);
    require(length == strlen(line) && length && line[length - 1] == '\n');
    for (size_t i = 0; i < length; i++) seen->hash = (seen->hash ^ (unsigned char)line[i]) * 0x100000001b3;
    seen->messages++;
    line[length - 1] = 0;
    require(wire_decode(line, &again) && again.kind == message->kind);
    require(wire_encode(&again, twice) == length);
    require(memcmp(line, twice, length - 1) == 0);
}

static struct seen read_lines(const uint8_t *data, size_t size, size_t piece) {
    struct wire_reader reader = {0};
    struct seen seen = {0};
    for (size_t i = 0, n; i < size; i += n) {
        n = piece < size - i ? piece : size - i;
        wire_read(&reader, (const char *)data + i, n, hear, &seen);
    }
    return seen;
}

static void count_stage(void *ctx, const char *name, double ms) {
    (void)ms;
    require(name != NULL);
    ++*(size_t *)ctx;
}

/* What is stored is read like what was sent. */
static void read_report(const char *text) {
    struct report_headline first, stored;
    size_t stages = 0, stored_stages = 0;
    report_read_headline(text, &first);
    report_read_timings(text, count_stage, &stages);
    char *compact = report_read_compact(text), *twice = report_read_compact(compact ? compact : "");
    require(!compact == !twice && (!compact || strcmp(compact, twice) == 0));
    report_read_headline(compact, &stored);
    report_read_timings(compact, count_stage, &stored_stages);
    require(!compact || (first.points_in == stored.points_in && stages == stored_stages));
    free(compact);
    free(twice);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (!size) return 0;
    if (data[0] == '{') {
        char *text = malloc(size + 1);
        require(text != NULL);
        memcpy(text, data, size);
        text[size] = 0;
        read_report(text);
        free(text);
        return 0;
    }
    struct seen whole = read_lines(data, size, size), pieces = read_lines(data, size, data[0] % 9u + 1);
    require(whole.hash == pieces.hash && whole.messages == pieces.messages);
    return 0;
}
