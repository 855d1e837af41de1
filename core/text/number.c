/* Numbers as text.
 *
 * Reading.  The digits are gathered to an integer w and a power of ten, value = w * 10^e.  Three ways, the first that
 * applies, and each of them rounds once:
 *   1. w <= 2^53 and |e| <= 22: both w and 10^|e| are exact doubles, so one multiplication or division is right.
 *      (W. D. Clinger: How to read floating point numbers accurately, 1990.)
 *   2. -19 <= e < 0: w / 10^-e as a 128 by 64 bit division, whose remainder becomes a sticky bit under the quotient's
 *      64 bits; the conversion of that to a double is then right.
 *   3. otherwise the C library, in the C locale, on a bounded copy.
 * A float is the double rounded again.  That is right unless the double lies exactly half-way between two floats, or
 * is subnormal as a float: then the C library is asked.
 *
 * Writing.  |value| = M * 2^e exactly, so round(|value| * 10^k) is an integer calculation in 128 bits for 0 <= k <= 19;
 * its digits are the candidate, which is taken when reading (way 1 or 2) gives the value back.
 *
 * Invariant: what is written here is read here to the same bits.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/text/number.h"

#include <ctype.h>
#include <float.h>
#include <locale.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

typedef unsigned __int128 uint128;

enum {
    WORD_BYTES = 500,      /* longest number that is read */
    MAX_DIGITS = 19,       /* 10^19 < 2^64 */
    MAX_EXPONENT = 100000, /* beyond this every number is 0 or infinite */
    EXACT_POWER = 22       /* 10^22 is the largest power of ten that is a double */
};

static const double power_of_ten[EXACT_POWER + 1] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                                     1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                                     1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

static const uint64_t integer_power_of_ten[MAX_DIGITS + 1] = {1,
                                                              10,
                                                              100,
                                                              1000,
                                                              10000,
                                                              100000,
                                                              1000000,
                                                              10000000,
                                                              100000000,
                                                              1000000000,
                                                              10000000000,
                                                              100000000000,
                                                              1000000000000,
                                                              10000000000000,
                                                              100000000000000,
                                                              1000000000000000,
                                                              10000000000000000,
                                                              100000000000000000,
                                                              1000000000000000000,
                                                              10000000000000000000u};

/* A number as it is written: (-) w * 10^exponent; long when digits beyond the 19th were left out of w. */
struct decimal {
    uint64_t w;
    int exponent;
    bool negative, is_long;
};

static bool is_digit(char c) { return (unsigned char)(c - '0') < 10; }
static bool is_exponent_mark(char c) { return (c | 32) == 'e' || (c | 32) == 'd'; }

/* 2^e for exponents of normal doubles. */
static double power_of_two(int e) {
    uint64_t bits = (uint64_t)(e + 1023) << 52;
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* w / 10^k, rounded once; 0 < w, 0 <= k <= 19. */
static double divide(uint64_t w, int k) {
    uint64_t d = integer_power_of_ten[k];
    int w_shift = __builtin_clzll(w), d_shift = __builtin_clzll(d);
    w <<= w_shift;
    d <<= d_shift;
    int q_shift = w >= d ? 63 : 64; /* so that the quotient fills 63 or 64 bits */
    uint128 n = (uint128)w << q_shift;
    uint64_t q = (uint64_t)(n / d);
    if (n % d) q |= 1;
    return (double)q * power_of_two(d_shift - w_shift - q_shift);
}

/* w * 10^exponent by way 1 or 2; false where neither applies. */
static bool convert(uint64_t w, int exponent, double *value) {
    if (w == 0 || exponent == 0)
        *value = (double)w;
    else if (FLT_EVAL_METHOD == 0 && w <= (uint64_t)1 << 53 && exponent >= -EXACT_POWER && exponent <= EXACT_POWER)
        *value = exponent < 0 ? (double)w / power_of_ten[-exponent] : (double)w * power_of_ten[exponent];
    else if (exponent <= 0 && exponent >= -MAX_DIGITS)
        *value = divide(w, -exponent);
    else
        return false;
    return true;
}

/* Adds the digits at p to n; returns the first byte after them. */
static const char *scan_digits(const char *p, const char *end, struct decimal *n, int *dropped) {
    for (; p < end && is_digit(*p); p++) {
        if (n->w < 1000000000000000000u) {
            n->w = n->w * 10 + (uint64_t)(*p - '0');
        } else {
            n->is_long = true;
            ++*dropped;
        }
    }
    return p;
}

/* Reads e+12 at p, if it is there; Fortran writes d for it. */
static const char *scan_exponent(const char *p, const char *end, int *exponent) {
    if (p == end || !is_exponent_mark(*p)) return p;
    const char *q = p + 1;
    bool negative = q < end && *q == '-';
    if (q < end && (*q == '-' || *q == '+')) q++;
    if (q == end || !is_digit(*q)) return p;
    int e = 0;
    for (; q < end && is_digit(*q); q++)
        if (e < MAX_EXPONENT) e = e * 10 + (*q - '0');
    *exponent = negative ? -e : e;
    return q;
}

static const char *scan(const char *p, const char *end, struct decimal *n) {
    *n = (struct decimal){0};
    int dropped = 0, exponent = 0;
    if (p < end && (*p == '-' || *p == '+')) n->negative = *p++ == '-';
    const char *whole = p;
    p = scan_digits(p, end, n, &dropped);
    ptrdiff_t digits = p - whole;
    if (p < end && *p == '.') {
        const char *fraction = ++p;
        int dropped_before = dropped;
        p = scan_digits(p, end, n, &dropped);
        digits += p - fraction;
        n->exponent = -(int)(p - fraction) + dropped - dropped_before;
    }
    if (digits == 0 || p - whole > WORD_BYTES) return NULL;
    p = scan_exponent(p, end, &exponent);
    n->exponent += exponent;
    return p;
}

/* Behind "nan" some libraries write which one it is: nan(ind), nan(0x8000). */
static const char *skip_payload(const char *p, const char *end) {
    const char *at = p;
    if (at == end || *at != '(') return p;
    do at++;
    while (at < end && (isalnum((unsigned char)*at) || *at == '_'));
    return at < end && *at == ')' ? at + 1 : p;
}

/* nan, inf or infinity at p, with a sign. */
static const char *scan_word(const char *p, const char *end, double *value) {
    static const struct {
        const char *name;
        size_t length;
        bool nan;
    } word[] = {{"infinity", 8, false}, {"inf", 3, false}, {"nan", 3, true}};
    bool negative = p < end && *p == '-';
    if (p < end && (*p == '-' || *p == '+')) p++;
    for (size_t i = 0; i < sizeof word / sizeof *word; i++) {
        if ((size_t)(end - p) < word[i].length || strncasecmp(p, word[i].name, word[i].length) != 0) continue;
        *value = copysign(word[i].nan ? (double)NAN : HUGE_VAL, negative ? -1 : 1);
        return word[i].nan ? skip_payload(p + word[i].length, end) : p + word[i].length;
    }
    return NULL;
}

/* What Microsoft's library wrote for such values: 1.#QNAN, -1.#IND, 1.#INF00; NULL: it isn't one. */
static const char *scan_microsoft(const char *p, const char *end, double *value) {
    static const char *const word[] = {"1.#INF", "1.#QNAN", "1.#SNAN", "1.#IND"};
    bool negative = p < end && *p == '-';
    if (p < end && (*p == '-' || *p == '+')) p++;
    for (size_t i = 0; i < sizeof word / sizeof *word; i++) {
        size_t length = strlen(word[i]);
        if ((size_t)(end - p) < length || strncasecmp(p, word[i], length) != 0) continue;
        *value = copysign(i ? (double)NAN : HUGE_VAL, negative ? -1 : 1);
        for (p += length; p < end && is_digit(*p);) p++;
        return p;
    }
    return NULL;
}

/* The C library's answer for the number at text .. after. */
static void library_parse(const char *text, const char *after, double *f64, float *f32) {
    char copy[WORD_BYTES + 40];
    size_t length = (size_t)(after - text) < sizeof copy ? (size_t)(after - text) : sizeof copy - 1;
    memcpy(copy, text, length);
    copy[length] = '\0';
    for (char *mark = copy; *mark; mark++)
        if (is_exponent_mark(*mark)) *mark = 'e';
    locale_t c = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    if (f64) *f64 = strtod_l(copy, NULL, c);
    if (f32) *f32 = strtof_l(copy, NULL, c);
    if (c) freelocale(c);
}

/* The plain numbers that files are full of: at most 15 digits and no exponent, by way 1.  NULL: it isn't one. */
static const char *parse_plain(const char *text, const char *end, double *value) {
    const char *p = text, *point = NULL;
    uint64_t w = 0;
    bool negative = p < end && *p == '-';
    if (negative) p++;
    const char *first = p, *last = end - p > 16 ? p + 16 : end;
    for (; p < last; p++) {
        if (is_digit(*p))
            w = w * 10 + (uint64_t)(*p - '0');
        else if (*p == '.' && !point)
            point = p;
        else
            break;
    }
    if (p == first + 16 || (p < end && is_exponent_mark(*p)) || p - first <= (point ? 1 : 0)) return NULL;
    double v = point ? (double)w / power_of_ten[p - point - 1] : (double)w;
    *value = negative ? -v : v;
    return p;
}

static const char *parse_finite(const char *text, const char *end, double *value) {
    const char *plain_end = FLT_EVAL_METHOD == 0 ? parse_plain(text, end, value) : NULL;
    if (plain_end) return plain_end;
    struct decimal n;
    const char *after = scan(text, end, &n);
    if (!after) return NULL;
    double v;
    if (n.is_long || !convert(n.w, n.exponent, &v))
        library_parse(text, after, value, NULL);
    else
        *value = n.negative ? -v : v;
    return after;
}

const char *number_parse_f64(const char *text, const char *end, double *value) {
    const char *after = parse_finite(text, end, value);
    if (!after) return scan_word(text, end, value);
    const char *word = after < end && *after == '#' ? scan_microsoft(text, end, value) : NULL;
    return word ? word : after;
}

/* Whether rounding d, itself rounded, to a float may differ from rounding the text. */
static bool rounds_twice(double d) {
    uint64_t bits;
    memcpy(&bits, &d, sizeof bits);
    return (bits & 0x1fffffff) == 0x10000000 || (d != 0 && fabs(d) < (double)FLT_MIN);
}

const char *number_parse_f32(const char *text, const char *end, float *value) {
    double d;
    const char *after = number_parse_f64(text, end, &d);
    if (!after) return NULL;
    if (rounds_twice(d))
        library_parse(text, after, NULL, value);
    else
        *value = (float)d;
    return after;
}

/* ------------------------------------------------------------------------------------------------ writing */

size_t number_format_int(char text[NUMBER_TEXT_BYTES], long long value) {
    char reversed[NUMBER_TEXT_BYTES];
    size_t n = 0, length = 0;
    unsigned long long rest = value < 0 ? 0 - (unsigned long long)value : (unsigned long long)value;
    do reversed[n++] = (char)('0' + rest % 10);
    while (rest /= 10);
    if (value < 0) text[length++] = '-';
    while (n) text[length++] = reversed[--n];
    return length;
}

/* m * 10^-k in plain digits, without trailing zeros; m < 10^18. */
static size_t plain(char *text, uint64_t m, int k) {
    while (k > 0 && m % 10 == 0) m /= 10, k--;
    size_t n = number_format_int(text, (long long)(m / integer_power_of_ten[k]));
    if (k == 0) return n;
    uint64_t fraction = m % integer_power_of_ten[k];
    text[n] = '.';
    for (int i = k; i > 0; i--, fraction /= 10) text[n + (size_t)i] = (char)('0' + fraction % 10);
    return n + 1 + (size_t)k;
}

/* round(value * 10^k) for a normal value > 0; false where 128 bits don't hold it. */
static bool scale_to_integer(double value, int k, uint64_t *m) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    int e = (int)(bits >> 52) - 1075;
    uint64_t mantissa = (bits & 0xfffffffffffff) | (uint64_t)1 << 52;
    if (k < 0 || k > MAX_DIGITS || e > 10 || e < -126) return false;
    uint128 product = (uint128)mantissa * integer_power_of_ten[k];
    if (e >= 0)
        product <<= e;
    else
        product = (product + ((uint128)1 << (-e - 1))) >> -e;
    *m = (uint64_t)product;
    return product < (uint128)1000000000000000000u;
}

/* floor(log10(value)) for 1e-5 <= value < 1e17. */
static int decimal_exponent(double value) {
    int e = -5;
    static const double below_one[5] = {1e-4, 1e-3, 1e-2, 1e-1, 1e0};
    while (e < 0 && value >= below_one[e + 5]) e++;
    if (value >= 1)
        while (value >= power_of_ten[e + 1]) e++;
    return e;
}

static bool reads_back(uint64_t m, int k, double value, bool is_float) {
    double d;
    if (!convert(m, -k, &d)) return false;
    return is_float ? !rounds_twice(d) && (double)(float)d == value : d == value;
}

/* In the C locale, for what is too large or too small for plain digits. */
static size_t library_format(char text[NUMBER_TEXT_BYTES], double value, int digits, bool is_float) {
    locale_t c = newlocale(LC_ALL_MASK, "C", (locale_t)0), before = uselocale(c);
    int most = is_float ? 9 : 17, n;
    bool same;
    do {
        n = snprintf(text, NUMBER_TEXT_BYTES, "%.*g", digits, value);
        same = is_float ? strtof_l(text, NULL, c) == (float)value : strtod_l(text, NULL, c) == value;
    } while (!same && ++digits <= most);
    uselocale(before);
    if (c) freelocale(c);
    return (size_t)n;
}

void number_print(char text[NUMBER_TEXT_BYTES], int digits, double value) {
    locale_t c = newlocale(LC_ALL_MASK, "C", (locale_t)0), before = uselocale(c);
    snprintf(text, NUMBER_TEXT_BYTES, "%.*g", digits, value);
    uselocale(before);
    if (c) freelocale(c);
}

double number_read(const char *text, char **end) {
    locale_t c = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    double value = strtod_l(text, end, c);
    if (c) freelocale(c);
    return value;
}

static size_t format(char text[NUMBER_TEXT_BYTES], double value, bool is_float) {
    double magnitude = fabs(value);
    size_t sign = signbit(value) ? 1 : 0;
    text[0] = '-';
    if (!isfinite(value)) return sign + (size_t)(memcpy(text + sign, isnan(value) ? "nan" : "inf", 3), 3);
    if (magnitude == 0) return text[sign] = '0', sign + 1;
    int digits = is_float ? 6 : 15, most = is_float ? 9 : 17;
    if (magnitude < 1e-5 || magnitude >= 1e17) return library_format(text, value, digits, is_float);
    int exponent = decimal_exponent(magnitude);
    for (int n = digits; n <= most; n++) {
        int k = n - 1 - exponent;
        uint64_t m;
        if (!scale_to_integer(magnitude, k < 0 ? 0 : k, &m)) break;
        if (reads_back(m, k < 0 ? 0 : k, magnitude, is_float)) return sign + plain(text + sign, m, k < 0 ? 0 : k);
    }
    return library_format(text, value, digits, is_float);
}

size_t number_format_f64(char text[NUMBER_TEXT_BYTES], double value) { return format(text, value, false); }

size_t number_format_f32(char text[NUMBER_TEXT_BYTES], float value) { return format(text, (double)value, true); }

const char *number_quote(const char *text, const char *end, char quote[NUMBER_QUOTE_BYTES]) {
    size_t n = 0;
    for (; text < end && !strchr(" \t\r\n\f\v", *text) && n < NUMBER_QUOTE_BYTES - 4; text++)
        quote[n++] = *text >= 32 && *text < 127 ? *text : '?';
    bool cut = n == NUMBER_QUOTE_BYTES - 4;
    memcpy(quote + n, cut ? "..." : "", cut ? 4 : 1);
    return quote;
}
