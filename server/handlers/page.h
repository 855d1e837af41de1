/* The page at /, server/handlers/page.html, as it is compiled into the program.  $HERE in it stands for the address at
 * which the service was asked.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HANDLERS_PAGE_H
#define WHITTLE_SERVER_HANDLERS_PAGE_H

#include <stddef.h>

/* The document's text, static, *bytes long, not ended by NUL. */
const char *page_document(size_t *bytes);

#endif
