/* The page, embedded: the assembler reads the file.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/handlers/page.h"

__asm__(".section .rodata\n"
        ".global page_begin\n.hidden page_begin\npage_begin:\n"
        ".incbin \"server/handlers/page.html\"\n"
        ".global page_end\n.hidden page_end\npage_end:\n"
        ".previous\n");

extern const char page_begin[], page_end[];

const char *page_document(size_t *bytes) {
    *bytes = (size_t)(page_end - page_begin);
    return page_begin;
}
