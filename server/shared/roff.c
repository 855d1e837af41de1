/* What groff would take for its own, behind a backslash.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/shared/roff.h"

#include <stdio.h>

void roff_print(const char *text) {
    if (*text == '.' || *text == '\'') fputs("\\&", stdout);
    for (; *text; text++) {
        if (*text == '-' || *text == '\\') putchar('\\');
        putchar(*text == '\\' ? 'e' : *text);
    }
}
