/* Signed paths, and the file of their key.
 *
 * The key appears by rename after fsync, as everything in the data folder: a crash in between leaves no half of one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/signature.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/base/digest.h"

enum { MESSAGE_BYTES = 1024 };

static enum status refused(struct error *error, const char *what, const char *path) {
    return error_set(error, STATUS_IO, "key", "can't %s %.200s: %s", what, path, strerror(errno));
}

static enum status read_key(int fd, const char *path, struct signature_key *key, struct error *error) {
    struct stat facts;
    if (fstat(fd, &facts) != 0) return refused(error, "look at", path);
    if (facts.st_mode & 077)
        return error_set(error, STATUS_MALFORMED, "key", "%.200s may be read by others; its mode has to be 0600", path);
    if (facts.st_size != SIGNATURE_KEY_BYTES)
        return error_set(error, STATUS_MALFORMED, "key", "%.200s holds no key; remove it to have a new one made", path);
    return pread(fd, key->bytes, sizeof key->bytes, 0) == SIGNATURE_KEY_BYTES ? STATUS_OK
                                                                              : refused(error, "read", path);
}

static enum status write_key(int fd, const char *path, const struct signature_key *key, struct error *error) {
    if (write(fd, key->bytes, sizeof key->bytes) != SIGNATURE_KEY_BYTES || fsync(fd) != 0)
        return refused(error, "write", path);
    return STATUS_OK;
}

/* Makes the file's name durable. */
static enum status sync_folder(const char *path, struct error *error) {
    char folder[PATH_MAX];
    snprintf(folder, sizeof folder, "%s", path);
    char *slash = strrchr(folder, '/');
    if (slash) *slash = 0;
    int fd = open(slash ? folder : ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    bool ok = fd >= 0 && fsync(fd) == 0;
    if (fd >= 0) close(fd);
    return ok ? STATUS_OK : refused(error, "sync the folder of", path);
}

enum status signature_write(const char *path, const struct signature_key *key, struct error *error) {
    char part[PATH_MAX];
    int n = snprintf(part, sizeof part, "%s.part", path);
    if (n < 0 || n >= PATH_MAX) return error_set(error, STATUS_IO, "key", "the path is too long");
    unlink(part); /* of a start that was cut off */
    int fd = open(part, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600);
    if (fd < 0) return refused(error, "make", part);
    enum status status = write_key(fd, part, key, error);
    close(fd);
    if (status == STATUS_OK && rename(part, path) != 0) status = refused(error, "rename", part);
    return status == STATUS_OK ? sync_folder(path, error) : status;
}

static enum status make_key(const char *path, struct signature_key *key, struct error *error) {
    if (getrandom(key->bytes, sizeof key->bytes, 0) != SIGNATURE_KEY_BYTES) return refused(error, "make", path);
    return signature_write(path, key, error);
}

enum status signature_open(const char *path, struct signature_key *key, struct error *error) {
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0) return errno == ENOENT ? make_key(path, key, error) : refused(error, "open", path);
    enum status status = read_key(fd, path, key, error);
    close(fd);
    return status;
}

void signature_make(const struct signature_key *key, const char *path, int64_t expires_s,
                    char hex[SIGNATURE_HEX_BYTES]) {
    char message[MESSAGE_BYTES];
    int n = snprintf(message, sizeof message, "GET\n%" PRId64 "\n%s", expires_s, path);
    size_t length = n < 0 ? 0 : (size_t)n < sizeof message ? (size_t)n : sizeof message - 1;
    digest_hmac(key->bytes, sizeof key->bytes, message, length, hex);
}

bool signature_holds(const struct signature_key *key, const char *path, int64_t expires_s, const char *hex) {
    char right[SIGNATURE_HEX_BYTES];
    if (strlen(hex) != SIGNATURE_HEX_BYTES - 1 || strlen(path) > MESSAGE_BYTES / 2) return false;
    signature_make(key, path, expires_s, right);
    return digest_same(right, hex);
}

void signature_key_text(const struct signature_key *key, char hex[SIGNATURE_HEX_BYTES]) {
    for (size_t i = 0; i < SIGNATURE_KEY_BYTES; i++) snprintf(hex + 2 * i, 3, "%02x", key->bytes[i]);
}

bool signature_key_read(const char *hex, struct signature_key *key) {
    static const char digits[] = "0123456789abcdef";
    if (strlen(hex) != SIGNATURE_HEX_BYTES - 1 || strspn(hex, digits) != SIGNATURE_HEX_BYTES - 1) return false;
    for (size_t i = 0; i < SIGNATURE_KEY_BYTES; i++)
        key->bytes[i] =
            (unsigned char)((strchr(digits, hex[2 * i]) - digits) * 16 + (strchr(digits, hex[2 * i + 1]) - digits));
    return true;
}
