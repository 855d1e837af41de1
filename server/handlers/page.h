/* The page at / and the files that it loads, as they are compiled into the program.  In the page $HERE stands for the
 * address at which the service was asked, and $BASE for the base path.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HANDLERS_PAGE_H
#define WHITTLE_SERVER_HANDLERS_PAGE_H

#include <stdbool.h>
#include <stddef.h>

/* The document's text, static, *bytes long, not ended by NUL. */
const char *page_document(size_t *bytes);

/* Whether the page loads files; the plain one doesn't. */
bool page_has_files(void);

/* The name of the script of /docs among the files, static; NULL for the plain page. */
const char *page_docs_script(void);

/* A file that the page loads, static; its name has a hash of its content. */
struct page_file {
    const char *type; /* its media type */
    const char *plain;
    size_t plain_bytes;
    const char *packed; /* by gzip */
    size_t packed_bytes;
};

/* false where there is none of this name. */
bool page_file(const char *name, struct page_file *found);

#endif
