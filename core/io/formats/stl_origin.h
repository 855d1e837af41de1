/* Where the header of a binary STL says that its coordinates are from another origin than 0.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_STL_ORIGIN_H
#define WHITTLE_CORE_IO_FORMATS_STL_ORIGIN_H

/* The 80 bytes before the count are this, three numbers with a blank between them, and the other, then zeros: what is
 * to be added to x, y and z. */
#define STL_ORIGIN_BEGIN "whittle; origin "
#define STL_ORIGIN_END " to be added"

#endif
