/* The contract, joined of the parts in api/openapi/, as it is compiled into the program.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_OPENAPI_OPENAPI_H
#define WHITTLE_API_OPENAPI_OPENAPI_H

#include <stddef.h>

/* The document's text, static, *bytes long, not ended by NUL. */
const char *openapi_document(size_t *bytes);

/* The same with the base path (api/links.h) as its server; returns new, NULL when memory runs out. */
char *openapi_here(void);

#endif
