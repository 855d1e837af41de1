/* Faults for unit tests.
 *
 * The programs are linked with --wrap for each function of malloc's family, so that what the project calls are the
 * functions here.  operator new is one of them: what it can't get it throws, through frames of C.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "tests/unit/faults.h"

#include <errno.h>
#include <pthread.h>
#include <sqlite3.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "api/codecs/json_memory.h"
#include "core/base/fault.h"
#include "tests/unit/folder.h"

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static struct {
    bool in_memory, in_new, lasts, happened, paused;
    const char *prefix; /* of the calls */
    int number;
    long passes_left; /* until the fault; 0 = none */
} faults;

static bool due(void) {
    if (faults.paused || !faults.passes_left || --faults.passes_left) return false;
    faults.passes_left = faults.lasts;
    faults.happened = true;
    return true;
}

static bool refuses_if(const bool *counts) {
    pthread_mutex_lock(&lock);
    bool now = *counts && due();
    pthread_mutex_unlock(&lock);
    if (now) errno = ENOMEM;
    return now;
}

static bool refuses(void) { return refuses_if(&faults.in_memory); }
static bool refuses_new(void) { return refuses_if(&faults.in_new); }

static int refuse_call(const char *point) {
    pthread_mutex_lock(&lock);
    int number = strncmp(point, faults.prefix, strlen(faults.prefix)) == 0 && due() ? faults.number : 0;
    pthread_mutex_unlock(&lock);
    return number;
}

/* ------------------------------------------------------------------------------------------------ memory */

void *__real_malloc(size_t bytes);
void *__real_aligned_alloc(size_t alignment, size_t bytes);
void *__real_calloc(size_t count, size_t bytes);
void *__real_realloc(void *old, size_t bytes);
void *__real_reallocarray(void *old, size_t count, size_t bytes);
char *__real_strdup(const char *text);
char *__real_strndup(const char *text, size_t most);
void *__real__Znwm(size_t bytes);

void *__wrap_malloc(size_t bytes);
void *__wrap_aligned_alloc(size_t alignment, size_t bytes);
void *__wrap_calloc(size_t count, size_t bytes);
void *__wrap_realloc(void *old, size_t bytes);
void *__wrap_reallocarray(void *old, size_t count, size_t bytes);
char *__wrap_strdup(const char *text);
char *__wrap_strndup(const char *text, size_t most);
void *__wrap__Znwm(size_t bytes);

_Noreturn void _ZSt17__throw_bad_allocv(void); /* std::__throw_bad_alloc */

void *__wrap_malloc(size_t bytes) { return refuses() ? NULL : __real_malloc(bytes); }
void *__wrap_aligned_alloc(size_t alignment, size_t bytes) {
    return refuses() ? NULL : __real_aligned_alloc(alignment, bytes);
}
void *__wrap_calloc(size_t count, size_t bytes) { return refuses() ? NULL : __real_calloc(count, bytes); }
void *__wrap_realloc(void *old, size_t bytes) { return refuses() ? NULL : __real_realloc(old, bytes); }
void *__wrap_reallocarray(void *old, size_t count, size_t bytes) {
    return refuses() ? NULL : __real_reallocarray(old, count, bytes);
}
char *__wrap_strdup(const char *text) { return refuses() ? NULL : __real_strdup(text); }
char *__wrap_strndup(const char *text, size_t most) { return refuses() ? NULL : __real_strndup(text, most); }
void *__wrap__Znwm(size_t bytes) {
    if (refuses_new()) _ZSt17__throw_bad_allocv();
    return __real__Znwm(bytes);
}

static sqlite3_mem_methods sqlite_memory;

static void *sqlite_malloc(int bytes) { return refuses() ? NULL : sqlite_memory.xMalloc(bytes); }
static void *sqlite_realloc(void *old, int bytes) { return refuses() ? NULL : sqlite_memory.xRealloc(old, bytes); }

int faults_set_up(void **state) {
    (void)state;
    json_memory_watch();
    sqlite3_config(SQLITE_CONFIG_LOOKASIDE, 0, 0);
    if (sqlite3_config(SQLITE_CONFIG_GETMALLOC, &sqlite_memory) != SQLITE_OK) return -1;
    sqlite3_mem_methods mine = sqlite_memory;
    mine.xMalloc = sqlite_malloc;
    mine.xRealloc = sqlite_realloc;
    return sqlite3_config(SQLITE_CONFIG_MALLOC, &mine) == SQLITE_OK ? 0 : -1;
}

/* ------------------------------------------------------------------------------------------------ faults */

static void begin_in(bool *counts, long nth, bool lasts) {
    pthread_mutex_lock(&lock);
    *counts = true;
    faults.lasts = lasts;
    faults.passes_left = nth;
    pthread_mutex_unlock(&lock);
}

void faults_in_memory(long nth, bool lasts) { begin_in(&faults.in_memory, nth, lasts); }
void faults_in_new(long nth) { begin_in(&faults.in_new, nth, false); }

void faults_in_calls(const char *prefix, long nth, bool lasts, int number) {
    faults.prefix = prefix;
    faults.number = number;
    faults.lasts = lasts;
    faults.passes_left = nth;
    fault_point = refuse_call;
}

static void pause_faults(bool paused) {
    pthread_mutex_lock(&lock);
    faults.paused = paused;
    pthread_mutex_unlock(&lock);
}

void faults_pause(void) { pause_faults(true); }
void faults_go_on(void) { pause_faults(false); }

bool faults_stop(void) {
    pthread_mutex_lock(&lock);
    bool happened = faults.happened;
    memset(&faults, 0, sizeof faults);
    pthread_mutex_unlock(&lock);
    fault_point = NULL;
    return happened;
}

int faults_tear_down(void **state) {
    const char *folder = *state;
    faults_stop();
    folder_remove(folder);
    free(*state);
    return 0;
}
