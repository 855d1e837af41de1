/* The contract as a page for people, made of the contract: no style and no font from anywhere else, and no
 * script but the one that tries operations out.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_DOCS_PAGE_H
#define WHITTLE_API_DOCS_PAGE_H

/* Returns new HTML text, NULL when memory runs out.  here is the address at which the service was asked, as curl takes
 * it; script is the name of one beside the page's files (server/page/docs.js), NULL where there is none. */
char *docs_page(const char *here, const char *script);

#endif
