/* Faults inside the database.
 *
 * SQLite reaches its files through a table of functions, the VFS, and through another one for each open file.  Here is
 * a VFS that is the system's but for xOpen, which gives each file a copy of its table: the calls that a disk may refuse
 * ask fault_at first.  The copy lies behind what the system's VFS keeps of the file.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/sql_faults.h"

#include <errno.h>
#include <sqlite3.h>
#include <stddef.h>

#include "core/base/fault.h"

static sqlite3_vfs *below, here;
static _Thread_local int last_errno; /* of the last fault, for xGetLastError */

struct layer {
    const sqlite3_io_methods *real;
    sqlite3_io_methods mine;
};

static size_t room_below(void) {
    size_t align = _Alignof(max_align_t);
    return ((size_t)below->szOsFile + align - 1) / align * align;
}

static const sqlite3_io_methods *real(sqlite3_file *file) {
    return ((struct layer *)(void *)((char *)file + room_below()))->real;
}

/* SQLITE_OK, or the code that the system's VFS returns where the call fails. */
static int ask(const char *point, int code) {
    if (!fault_at(point)) return SQLITE_OK;
    last_errno = errno;
    return code;
}

static int read_file(sqlite3_file *file, void *bytes, int count, sqlite3_int64 offset) {
    int code = ask("database-read", SQLITE_IOERR_READ);
    return code ? code : real(file)->xRead(file, bytes, count, offset);
}

static int write_file(sqlite3_file *file, const void *bytes, int count, sqlite3_int64 offset) {
    int code = ask("database-write", SQLITE_IOERR_WRITE);
    if (code && last_errno == ENOSPC) code = SQLITE_FULL;
    return code ? code : real(file)->xWrite(file, bytes, count, offset);
}

static int sync_file(sqlite3_file *file, int flags) {
    int code = ask("database-sync", SQLITE_IOERR_FSYNC);
    return code ? code : real(file)->xSync(file, flags);
}

static int truncate_file(sqlite3_file *file, sqlite3_int64 size) {
    int code = ask("database-truncate", SQLITE_IOERR_TRUNCATE);
    return code ? code : real(file)->xTruncate(file, size);
}

static int map_file(sqlite3_file *file, int page, int bytes, int extend, void volatile **at) {
    int code = ask("database-map", SQLITE_IOERR_SHMSIZE);
    return code ? code : real(file)->xShmMap(file, page, bytes, extend, at);
}

static int open_file(sqlite3_vfs *vfs, sqlite3_filename name, sqlite3_file *file, int flags, int *out) {
    (void)vfs;
    struct layer *layer = (void *)((char *)file + room_below());
    file->pMethods = NULL;
    int code = ask("database-open", SQLITE_CANTOPEN);
    if (!code) code = below->xOpen(below, name, file, flags, out);
    if (!file->pMethods) return code;
    layer->real = file->pMethods;
    layer->mine = *file->pMethods;
    layer->mine.xRead = read_file;
    layer->mine.xWrite = write_file;
    layer->mine.xSync = sync_file;
    layer->mine.xTruncate = truncate_file;
    layer->mine.xShmMap = map_file;
    file->pMethods = &layer->mine;
    return code;
}

static int get_last_error(sqlite3_vfs *vfs, int count, char *text) {
    (void)vfs;
    return last_errno ? last_errno : below->xGetLastError(below, count, text);
}

const char *sql_faults_vfs(void) {
    if (below) return here.zName;
    below = sqlite3_vfs_find("unix");
    if (!below) return NULL;
    here = *below;
    here.zName = "whittle-faults";
    here.szOsFile = (int)(room_below() + sizeof(struct layer));
    here.xOpen = open_file;
    here.xGetLastError = get_last_error;
    return sqlite3_vfs_register(&here, 0) == SQLITE_OK ? here.zName : NULL;
}
