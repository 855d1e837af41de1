/* The contract, embedded: the assembler reads what parts.py has joined.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/openapi/openapi.h"

#include <stdio.h>
#include <string.h>

#include "api/links.h"

__asm__(".section .rodata\n"
        ".global openapi_begin\n.hidden openapi_begin\nopenapi_begin:\n"
        ".incbin \"" OPENAPI_JSON "\"\n"
        ".global openapi_end\n.hidden openapi_end\nopenapi_end:\n"
        ".previous\n");

extern const char openapi_begin[], openapi_end[];

const char *openapi_document(size_t *bytes) {
    *bytes = (size_t)(openapi_end - openapi_begin);
    return openapi_begin;
}

char *openapi_here(void) {
    static const char server[] = "\"url\": \"/\"";
    size_t bytes;
    const char *document = openapi_document(&bytes), *base = links_base();
    const char *found = base[0] ? memmem(document, bytes, server, sizeof server - 1) : NULL;
    char *text;
    if (!found) return strndup(document, bytes);
    const char *rest = found + sizeof server - 1;
    int n = asprintf(&text, "%.*s\"url\": \"%s\"%.*s", (int)(found - document), document, base,
                     (int)(document + bytes - rest), rest);
    return n < 0 ? NULL : text;
}
