/* Bearer tokens.
 *
 * A token is looked for by its hash, and every row is compared to its last byte whatever the rows before said: how long
 * it takes tells nothing about which bytes were right.
 *
 * Invariant: `rows` is only exchanged as a whole, under the lock, by a list that was read without a fault.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/auth/tokens.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/base/digest.h"
#include "server/base/setting_file.h"

enum { LINE_BYTES = 512 };

struct row {
    struct principal principal;
    char sha256[DIGEST_HEX_BYTES];
};

struct list {
    struct row *row;
    size_t count, room;
};

struct tokens {
    char *path;
    pthread_rwlock_t lock;
    struct list list;
};

static const struct {
    const char *name;
    enum routes_scope scope;
} scopes[] = {{"submit", ROUTES_SUBMIT}, {"read", ROUTES_READ}, {"admin", ROUTES_ADMIN}};
enum { SCOPES = sizeof scopes / sizeof scopes[0] };

/* ------------------------------------------------------------------------------------------------ lines */

static bool read_name(const char *text, size_t length, struct row *row) {
    static const char allowed[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._@-";
    if (length == 0 || length >= sizeof row->principal.name || strspn(text, allowed) < length) return false;
    memcpy(row->principal.name, text, length);
    return true;
}

static bool read_scopes(const char *text, size_t length, struct row *row) {
    for (const char *end = text + length; text < end;) {
        size_t word = strcspn(text, ",:"), i = 0;
        while (i < SCOPES && (strlen(scopes[i].name) != word || strncmp(scopes[i].name, text, word) != 0)) i++;
        if (i == SCOPES) return false;
        row->principal.scopes |= scopes[i].scope;
        text += word + 1;
    }
    return row->principal.scopes != 0;
}

static bool read_hash(const char *text, struct row *row) {
    if (strlen(text) != DIGEST_HEX_BYTES - 1) return false;
    for (size_t i = 0; i < DIGEST_HEX_BYTES - 1; i++) {
        char c = text[i];
        bool upper = c >= 'A' && c <= 'F';
        if (!upper && !(c >= 'a' && c <= 'f') && !(c >= '0' && c <= '9')) return false;
        row->sha256[i] = upper ? (char)(c - 'A' + 'a') : c;
    }
    return true;
}

/* NULL, or what is wrong with the line. */
static const char *read_row(const char *line, struct row *row) {
    const char *first = strchr(line, ':'), *second = first ? strchr(first + 1, ':') : NULL;
    if (!second) return "a line is name:scopes:sha256";
    if (!read_name(line, (size_t)(first - line), row)) return "a name is 1 to 64 of letters, digits, . _ @ -";
    if (!read_scopes(first + 1, (size_t)(second - first - 1), row)) return "scopes are some of submit,read,admin";
    if (!read_hash(second + 1, row)) return "the hash is 64 hexadecimal digits";
    return NULL;
}

static bool add(struct list *list, const struct row *row) {
    if (list->count == list->room) {
        size_t room = list->room ? 2 * list->room : 16;
        struct row *grown = realloc(list->row, room * sizeof *grown); /* at most TOKENS_MAX rows */
        if (!grown) return false;
        list->row = grown;
        list->room = room;
    }
    list->row[list->count++] = *row;
    return true;
}

/* ------------------------------------------------------------------------------------------------ the file */

/* Cuts comment and blanks off; false: the line didn't fit. */
static bool tidy(char *line) {
    size_t length = strlen(line);
    bool whole = length + 1 < LINE_BYTES || line[length - 1] == '\n';
    line[strcspn(line, "#")] = 0;
    for (length = strlen(line); length && strchr(" \t\r\n", line[length - 1]); length--) line[length - 1] = 0;
    return whole;
}

static enum status read_lines(FILE *file, const char *path, struct list *list, struct error *error) {
    char line[LINE_BYTES];
    for (unsigned number = 1; fgets(line, sizeof line, file); number++) {
        struct row row = {0};
        const char *wrong = tidy(line) ? NULL : "the line is too long";
        if (!wrong && !line[0]) continue;
        if (!wrong) wrong = read_row(line, &row);
        if (!wrong && list->count == TOKENS_MAX) wrong = "there are too many tokens";
        if (wrong)
            return error_set(error, STATUS_BAD_PARAMETER, "tokens-file", "%.200s, line %u: %s", path, number, wrong);
        if (!add(list, &row)) return error_set(error, STATUS_NO_MEMORY, "tokens-file", "no memory");
    }
    if (ferror(file)) return error_set(error, STATUS_IO, "tokens-file", "can't read %.200s", path);
    if (list->count == 0) return error_set(error, STATUS_BAD_PARAMETER, "tokens-file", "%.200s names no token", path);
    return STATUS_OK;
}

static enum status read_file(const char *path, struct list *list, struct error *error) {
    FILE *file;
    enum status status = setting_file_open("tokens-file", path, &file, error);
    if (status != STATUS_OK) return status;
    status = read_lines(file, path, list, error);
    fclose(file);
    return status;
}

/* ------------------------------------------------------------------------------------------------ public */

enum status tokens_open(const char *path, struct tokens **tokens, struct error *error) {
    struct tokens *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "tokens-file", "no memory");
    pthread_rwlock_init(&opened->lock, NULL);
    opened->path = strdup(path);
    enum status status = opened->path ? read_file(path, &opened->list, error)
                                      : error_set(error, STATUS_NO_MEMORY, "tokens-file", "no memory");
    if (status == STATUS_OK)
        *tokens = opened;
    else
        tokens_close(opened);
    return status;
}

void tokens_close(struct tokens *tokens) {
    if (!tokens) return;
    pthread_rwlock_destroy(&tokens->lock);
    free(tokens->list.row);
    free(tokens->path);
    free(tokens);
}

enum status tokens_reload(struct tokens *tokens, struct error *error) {
    struct list fresh = {0};
    enum status status = read_file(tokens->path, &fresh, error);
    if (status == STATUS_OK) {
        struct list stale = tokens->list;
        pthread_rwlock_wrlock(&tokens->lock);
        tokens->list = fresh;
        pthread_rwlock_unlock(&tokens->lock);
        fresh = stale;
    }
    free(fresh.row);
    return status;
}

size_t tokens_count(struct tokens *tokens) {
    pthread_rwlock_rdlock(&tokens->lock);
    size_t count = tokens->list.count;
    pthread_rwlock_unlock(&tokens->lock);
    return count;
}

bool tokens_find(struct tokens *tokens, const char *token, struct principal *principal) {
    char sha256[DIGEST_HEX_BYTES];
    bool found = false;
    if (strlen(token) > TOKENS_MAX_BYTES || !digest_text(token, sha256)) return false;
    pthread_rwlock_rdlock(&tokens->lock);
    for (size_t i = 0; i < tokens->list.count; i++) {
        const struct row *row = &tokens->list.row[i];
        if (!digest_same(row->sha256, sha256)) continue;
        *principal = row->principal;
        found = true;
    }
    pthread_rwlock_unlock(&tokens->lock);
    return found;
}
