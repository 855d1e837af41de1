/* Text in manual pages, of both programs.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_SHARED_ROFF_H
#define WHITTLE_SERVER_SHARED_ROFF_H

/* Prints text so that nothing in it is a request: hyphens can be copied, a line may begin with a dot. */
void roff_print(const char *text);

#endif
