/* The one seam through which tests make the operating system fail.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/fault.h"

#include <errno.h>
#include <stddef.h>

int (*fault_point)(const char *point);

bool fault_at(const char *point) {
    int number = fault_point ? fault_point(point) : 0;
    if (number) errno = number;
    return number != 0;
}
