/* LAS 1.4 R15, 2.7 and 3.1: a record of user LASF_Projection is a directory of GeoTIFF keys (34735), of which 3072
 * (projected) or 2048 (geographic) is the number that EPSG gives the system, or text (2112, OGC WKT), whose last
 * AUTHORITY["EPSG", "number"] or ID["EPSG", number] closes the whole of it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/formats/las_fields.h"

#include <ctype.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/base/endian.h"

enum { HEADER_BYTES = 227, VLR_BYTES = 54, RECORD_BYTES = 65535, WKT = 2112, KEYS = 34735 };
enum { KEY_BYTES = 8, PROJECTED = 3072, GEOGRAPHIC = 2048, USER_DEFINED = 32767 };

static bool read_at(int fd, void *to, size_t n, uint64_t at) { return pread(fd, to, n, (off_t)at) == (ssize_t)n; }

static bool find_key(const unsigned char *record, size_t n, unsigned wanted, char *text, size_t text_bytes) {
    for (size_t at = KEY_BYTES; at + KEY_BYTES <= n; at += KEY_BYTES) {
        unsigned key = (unsigned)load_little_endian(record + at, 2),
                 value = (unsigned)load_little_endian(record + at + 6, 2);
        if (key != wanted || load_little_endian(record + at + 2, 2) != 0 || value == 0 || value == USER_DEFINED)
            continue;
        snprintf(text, text_bytes, "EPSG:%u", value);
        return true;
    }
    return false;
}

/* The number after the last "EPSG", where only quotes, commas and blanks stand between. */
static bool find_number(const char *wkt, char *text, size_t text_bytes) {
    const char *last = NULL;
    for (const char *at = wkt; (at = strstr(at, "\"EPSG\"")) != NULL; at++) last = at;
    if (!last) return false;
    for (last += strlen("\"EPSG\""); *last && strchr("\", ", *last);) last++;
    int digits = (int)strspn(last, "0123456789");
    if (digits == 0 || digits > 9) return false;
    size_t brackets = 0; /* its own and that of the whole: where more follow, it is the number of a part */
    for (const char *c = last + digits; *c; c++) brackets += *c == ']' || *c == ')';
    if (brackets != 2) return false;
    snprintf(text, text_bytes, "EPSG:%.*s", digits, last);
    return true;
}

static bool find_name(const char *wkt, char *text, size_t text_bytes) {
    const char *begin = strchr(wkt, '"'), *end = begin ? strchr(begin + 1, '"') : NULL;
    if (!end || end == begin + 1) return false;
    snprintf(text, text_bytes, "%.*s", (int)(end - begin - 1), begin + 1);
    for (char *c = text; *c; c++)
        if (!isprint((unsigned char)*c)) *c = '?';
    return true;
}

static bool find_in(const unsigned char *record, size_t n, unsigned id, char *text, size_t text_bytes) {
    const char *wkt = (const char *)record;
    if (id == KEYS)
        return find_key(record, n, PROJECTED, text, text_bytes) || find_key(record, n, GEOGRAPHIC, text, text_bytes);
    return id == WKT && (find_number(wkt, text, text_bytes) || find_name(wkt, text, text_bytes));
}

bool las_records_system(const struct cloud_las *las, char *text, size_t text_bytes) {
    text[0] = 0;
    for (size_t at = 0; at < las->records_bytes;) {
        const unsigned char *vlr = las->records + at;
        size_t length = (size_t)load_little_endian(vlr + 20, 2);
        char record[RECORD_BYTES + 1];
        memcpy(record, vlr + VLR_BYTES, length);
        record[length] = 0;
        at += VLR_BYTES + length;
        if (strncmp((const char *)vlr + 2, "LASF_Projection", 16) == 0 &&
            find_in((const unsigned char *)record, length, (unsigned)load_little_endian(vlr + 18, 2), text, text_bytes))
            return true;
    }
    return false;
}

bool las_system_is_keys(const struct cloud_las *las) {
    bool has_keys = false;
    for (size_t at = 0; at < las->records_bytes;) {
        const unsigned char *vlr = las->records + at;
        at += VLR_BYTES + (size_t)load_little_endian(vlr + 20, 2);
        if (strncmp((const char *)vlr + 2, "LASF_Projection", 16) != 0) continue;
        if (load_little_endian(vlr + 18, 2) == WKT) return false;
        has_keys = true;
    }
    return has_keys;
}

bool las_coordinate_system(int fd, char *text, size_t text_bytes) {
    unsigned char header[HEADER_BYTES], vlr[VLR_BYTES], record[RECORD_BYTES + 1];
    bool found = false;
    text[0] = 0;
    if (!read_at(fd, header, sizeof header, 0) || memcmp(header, "LASF", 4) != 0) return false;
    uint64_t at = load_little_endian(header + 94, 2), points = load_little_endian(header + 96, 4);
    for (uint64_t left = load_little_endian(header + 100, 4); left > 0 && at + VLR_BYTES <= points && !found; left--) {
        if (!read_at(fd, vlr, sizeof vlr, at)) return false;
        size_t length = (size_t)load_little_endian(vlr + 20, 2);
        at += VLR_BYTES;
        if (strncmp((const char *)vlr + 2, "LASF_Projection", 16) == 0 && read_at(fd, record, length, at)) {
            record[length] = 0;
            found = find_in(record, length, (unsigned)load_little_endian(vlr + 18, 2), text, text_bytes);
        }
        at += length;
    }
    return found;
}
