/* Tar archives (POSIX.1-2008 pax, and GNU's long names): which files are where.
 *
 *     archive = {header of 512 bytes, then the file, filled up to a multiple of 512}, a header of zeros
 *     header  = name 100 | ... | size 12, octal, at 124 | ... | sum of the header's bytes 8, at 148 | kind, at 156 |
 *               ... | "ustar", at 257 | ... | prefix of the name 155, at 345
 *
 * A name is its last part, so the prefix doesn't matter.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/formats/tar_members.h"

#include <stdio.h>
#include <string.h>

#include "core/io/first_bytes.h"
#include "core/io/reader.h"

enum { SIZE_AT = 124, SIZE_BYTES = 12, SUM_AT = 148, SUM_BYTES = 8, KIND_AT = 156, MARK_AT = 257 };

/* ------------------------------------------------------------------------------------------------ headers */

/* Octal digits with blanks around, or with the first bit set a number of 8 bits a byte. */
static bool take_header_number(const unsigned char *field, size_t n, uint64_t *value) {
    uint64_t number = 0;
    size_t i = 0;
    if (field[0] & 0x80) {
        if (field[0] & 0x7f) return false;
        for (i = 1; i < n; i++) {
            if (number >> 55) return false;
            number = number << 8 | field[i];
        }
        *value = number;
        return true;
    }
    while (i < n && field[i] == ' ') i++;
    for (; i < n && field[i] >= '0' && field[i] <= '7'; i++) number = number << 3 | (uint64_t)(field[i] - '0');
    *value = number;
    return i == n || field[i] == ' ' || field[i] == 0;
}

/* Whether it is a header, by its mark and its sum, in which the sum itself counts as blanks. */
static bool is_header(const unsigned char *header) {
    uint64_t sum = 0, told;
    for (size_t i = 0; i < TAR_BLOCK_BYTES; i++) sum += i >= SUM_AT && i < SUM_AT + SUM_BYTES ? ' ' : header[i];
    return memcmp(header + MARK_AT, "ustar", 5) == 0 && take_header_number(header + SUM_AT, SUM_BYTES, &told) &&
           told == sum;
}

static bool is_zero(const unsigned char *header) {
    for (size_t i = 0; i < TAR_BLOCK_BYTES; i++)
        if (header[i]) return false;
    return true;
}

const char *cloud_tar_look(const struct first_bytes *first) {
    bool whole = first->n >= TAR_BLOCK_BYTES;
    return whole && is_header((const unsigned char *)first->text) ? "tar" : "";
}

/* ------------------------------------------------------------------------------------------------ the archive */

/* What an extended header says of the next member. */
struct extended {
    char name[TAR_NAME_BYTES]; /* "" = nothing */
    bool has_size;
    uint64_t size;
};

/* Lines "length key=value\n". */
static void take_extended(const char *text, size_t n, struct extended *extended) {
    for (size_t at = 0; at < n;) {
        size_t length = 0, digits = 0;
        while (at + digits < n && digits < 8 && text[at + digits] >= '0' && text[at + digits] <= '9')
            length = 10 * length + (size_t)(text[at + digits++] - '0');
        if (digits == 0 || length <= digits + 1 || length > n - at) return;
        const char *key = text + at + digits + 1, *end = text + at + length - 1;
        if (end - key > 5 && memcmp(key, "path=", 5) == 0)
            snprintf(extended->name, TAR_NAME_BYTES, "%.*s", (int)(end - key - 5), key + 5);
        if (end - key > 5 && memcmp(key, "size=", 5) == 0) {
            extended->has_size = true;
            extended->size = 0;
            for (const char *c = key + 5; c < end && *c >= '0' && *c <= '9' && extended->size < UINT64_MAX / 16; c++)
                extended->size = 10 * extended->size + (uint64_t)(*c - '0');
        }
        at += length;
    }
}

/* Without its folders, with what isn't printable as '?'. */
static void take_name(const unsigned char *header, const struct extended *extended, char name[TAR_NAME_BYTES]) {
    char whole[TAR_NAME_BYTES];
    snprintf(whole, sizeof whole, "%.100s", extended->name[0] ? "" : (const char *)header);
    if (extended->name[0]) memcpy(whole, extended->name, sizeof whole);
    const char *slash = strrchr(whole, '/');
    snprintf(name, TAR_NAME_BYTES, "%s", slash ? slash + 1 : whole);
    for (char *c = name; *c; c++)
        if (*c < 32 || *c > 126) *c = '?';
}

bool tar_next(const void *bytes, size_t n, struct tar_member *member) {
    const unsigned char *archive = bytes;
    struct extended extended = {.name = ""};
    uint64_t at = member->next;
    member->wrong = NULL;
    while (at < n && n - at >= TAR_BLOCK_BYTES) {
        const unsigned char *header = archive + at;
        uint64_t size;
        member->at = at;
        if (is_zero(header)) return false;
        if (!is_header(header) || !take_header_number(header + SIZE_AT, SIZE_BYTES, &size)) {
            member->wrong = "no header of a member is here";
            return false;
        }
        unsigned char kind = header[KIND_AT];
        bool is_file = kind == '0' || kind == 0 || kind == '7', has_data = is_file || strchr("xgLK", kind);
        if (is_file && extended.has_size) size = extended.size;
        if (!has_data) size = 0;
        at += TAR_BLOCK_BYTES;
        if (kind == 'x' && size <= n - at) take_extended((const char *)archive + at, (size_t)size, &extended);
        if (kind == 'L' && size <= n - at)
            snprintf(extended.name, TAR_NAME_BYTES, "%.*s", (int)(size < TAR_NAME_BYTES ? size : TAR_NAME_BYTES),
                     (const char *)archive + at);
        if (is_file) {
            take_name(header, &extended, member->name);
            extended = (struct extended){.name = ""};
            member->first = at, member->bytes = size;
        }
        bool whole = size <= n - at, last = whole && n - at - size < TAR_BLOCK_BYTES - 1;
        member->next = !whole ? n : last ? n : at + (size + TAR_BLOCK_BYTES - 1) / TAR_BLOCK_BYTES * TAR_BLOCK_BYTES;
        if (is_file && member->name[0] && member->name[0] != '.') return true;
        if (!is_file && !strchr("xgLK", kind)) extended = (struct extended){.name = ""};
        at = member->next;
    }
    return false;
}
