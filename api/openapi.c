/* The contract, embedded: the assembler reads the file, so the program and the file in the tree can't differ.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/openapi.h"

__asm__(".section .rodata\n"
        ".global openapi_begin\n.hidden openapi_begin\nopenapi_begin:\n"
        ".incbin \"api/openapi.json\"\n"
        ".global openapi_end\n.hidden openapi_end\nopenapi_end:\n"
        ".previous\n");

extern const char openapi_begin[], openapi_end[];

const char *openapi_document(size_t *bytes) {
    *bytes = (size_t)(openapi_end - openapi_begin);
    return openapi_begin;
}
