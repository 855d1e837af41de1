/* Faults for unit tests: the n-th allocation, or the n-th call that core/base/fault.h names, fails.
 *
 * Allocations are those of the project's own code (the linker puts ours before the library's), SQLite's and jansson's.
 * Those of all threads count; calls are to be refused where there is one thread alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_UNIT_FAULTS_H
#define WHITTLE_TESTS_UNIT_FAULTS_H

#include <stdbool.h>

/* Before anything of SQLite is used: a set-up of a group. */
int faults_set_up(void **state);

/* For tests whose *state is memory that begins with the name of a folder: ends the faults, removes the folder, frees
 * the memory. */
int faults_tear_down(void **state);

/* The nth allocation fails, and those after it too where it lasts. */
void faults_in_memory(long nth, bool lasts);

/* The nth allocation of FLANN's by operator new fails.  (CGAL's would leave tables of a thread's own half filled, and
 * the thread couldn't triangulate again.) */
void faults_in_new(long nth);

/* The same as in memory, of calls whose point starts with prefix; they fail with this errno. */
void faults_in_calls(const char *prefix, long nth, bool lasts, int number);

/* Nothing fails in between, and nothing counts. */
void faults_pause(void);
void faults_go_on(void);

/* Ends the faults; whether one has happened. */
bool faults_stop(void);

#endif
