/* Memory of the exact numbers that triangulations decide by where double can't (GMP's).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_EXACT_NUMBERS_H
#define WHITTLE_SERVER_CLI_EXACT_NUMBERS_H

/* Calls end() where there is no memory for one, in the thread that wants it; end() must not return.  Without it GMP
 * prints a line of its own and aborts.  For the whole process; before the first exact number. */
void worker_exact_numbers_end_by(void (*end)(void));

#endif
