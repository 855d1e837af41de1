/* Numbers as text: reading and writing that is exact, fast and the same in every locale.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TEXT_NUMBER_H
#define WHITTLE_CORE_TEXT_NUMBER_H

#include <stddef.h>

/* Room for any number that number_format_* writes, and for any quotation of NUMBER_QUOTE_BYTES. */
enum { NUMBER_TEXT_BYTES = 32, NUMBER_QUOTE_BYTES = 40 };

/* Read the decimal number that starts at text (text < end is not needed; there need be no NUL): sign, digits, point,
 * exponent, or nan, inf, infinity in any case, also as Microsoft's library writes them.  The value is the nearest one
 * to what is written (ties to even), and infinite where it overflows.  Return the first byte after it, or NULL when no
 * number starts there or it is longer than 500 bytes; then *value is untouched. */
const char *number_parse_f64(const char *text, const char *end, double *value);
const char *number_parse_f32(const char *text, const char *end, float *value);

/* Write the shortest of 15 to 17 (float: 6 to 9) significant digits that reads back to the same bits (NaN: to a NaN of
 * the same sign), without a NUL.  Return how many bytes were written, at most NUMBER_TEXT_BYTES. */
size_t number_format_f64(char text[NUMBER_TEXT_BYTES], double value);
size_t number_format_f32(char text[NUMBER_TEXT_BYTES], float value);

/* The same for whole numbers. */
size_t number_format_int(char text[NUMBER_TEXT_BYTES], long long value);

/* What strtod reads, and what snprintf writes for "%.*g", in the C locale whatever the program's is: for parameters and
 * attributes, of which there are few. */
double number_read(const char *text, char **end);
void number_print(char text[NUMBER_TEXT_BYTES], int digits, double value);

/* Copies the word at text (up to a blank or end) to quote for an error message: unprintable bytes become '?', long
 * words are cut and end in "...".  Returns quote. */
const char *number_quote(const char *text, const char *end, char quote[NUMBER_QUOTE_BYTES]);

#endif
