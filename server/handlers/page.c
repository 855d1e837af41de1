/* The page's files, embedded: the assembler reads them.  `make page` leaves a list of them, which the compiler is told
 * to include (PAGE_FILES and PAGE_INDEX); without it there is the plain page alone.
 *
 * A file is found by its name among those that were there when the program was built, so no name leads anywhere else.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/handlers/page.h"

#include <string.h>

#ifndef PAGE_INDEX
#define PAGE_INDEX "server/page/plain.html"
#define PAGE_FILES(FILE)
#endif
#ifndef PAGE_DOCS
#define PAGE_DOCS NULL
#endif

#define EMBED(symbol, path)                                                                                            \
    ".section .rodata\n.global " symbol "_begin\n.hidden " symbol "_begin\n" symbol "_begin:\n.incbin \"" path "\"\n"  \
    ".global " symbol "_end\n.hidden " symbol "_end\n" symbol "_end:\n.previous\n"
#define EMBED_FILE(n, name, type, path) EMBED("page_plain_" #n, path) EMBED("page_packed_" #n, path ".gz")
#define DECLARE_FILE(n, name, type, path)                                                                              \
    extern const char page_plain_##n##_begin[], page_plain_##n##_end[], page_packed_##n##_begin[],                     \
        page_packed_##n##_end[];
#define FILE_ROW(n, name, type, path)                                                                                  \
    {name, type, page_plain_##n##_begin, page_plain_##n##_end, page_packed_##n##_begin, page_packed_##n##_end},

__asm__(EMBED("page", PAGE_INDEX) PAGE_FILES(EMBED_FILE));

extern const char page_begin[], page_end[];
PAGE_FILES(DECLARE_FILE)

static const struct file {
    const char *name, *type, *plain, *plain_end, *packed, *packed_end;
} files[] = {PAGE_FILES(FILE_ROW){NULL, NULL, NULL, NULL, NULL, NULL}};

const char *page_document(size_t *bytes) {
    *bytes = (size_t)(page_end - page_begin);
    return page_begin;
}

bool page_has_files(void) { return files[0].name != NULL; }

const char *page_docs_script(void) { return PAGE_DOCS; }

bool page_file(const char *name, struct page_file *found) {
    for (const struct file *file = files; file->name; file++) {
        if (strcmp(file->name, name) != 0) continue;
        *found = (struct page_file){file->type, file->plain, (size_t)(file->plain_end - file->plain), file->packed,
                                    (size_t)(file->packed_end - file->packed)};
        return true;
    }
    return false;
}
