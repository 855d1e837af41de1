/* The contract as a page for people, made of the contract: no script, no style and no font from anywhere
 * else.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_DOCS_PAGE_H
#define WHITTLE_API_DOCS_PAGE_H

/* Returns new HTML text, NULL when memory runs out.  here is the address at which the service was asked, as curl takes
 * it. */
char *docs_page(const char *here);

#endif
