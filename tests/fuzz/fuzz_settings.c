/* Fuzzes what an operator writes: the file of settings, arguments, environment, the file of tokens.
 *
 * The first line chooses: "file", "flags", "environment" or "tokens"; the others are the text, or one argument or
 * variable each.  What is refused says why; what is taken is the same when it is read again.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "server/auth/tokens.h"
#include "server/jobs/config.h"

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { MAX_LINES = 64, PATH_BYTES = 64 };

static void require(int condition) {
    if (!condition) abort();
}

/* --help and its like aren't looked at. */
int LLVMFuzzerInitialize(int *argc, char ***argv) {
    (void)argc;
    (void)argv;
    require(freopen("/dev/null", "w", stdout) != NULL);
    return 0;
}

static void never(const char *name, bool live) {
    (void)name;
    (void)live;
    abort();
}

static void try_config(int argc, char **argv, char **environment) {
    static struct config config, again;
    struct error error = {0};
    const char *name;
    int64_t value;
    enum config_request request = config_read(&config, argc, argv, environment, &error);
    require(request != CONFIG_REFUSED || (error.code && error.where[0] && error.text[0]));
    if (request != CONFIG_RUN) return;
    for (size_t i = 0; config_limit(&config, i, &name, &value); i++) require(name[0] && value >= 0);
    require(config.workers > 0 && config.threads_per_job > 0 && config.job_memory_bytes > 0);
    require(config_reload(&config, argc, argv, environment, &again, never, &error) == STATUS_OK);
}

static void try_tokens(const char *path) {
    struct tokens *tokens = NULL;
    struct principal principal;
    struct error error = {0};
    enum status status = tokens_open(path, &tokens, &error);
    require(status ? error.text[0] != 0 : tokens_count(tokens) > 0);
    if (status) return;
    size_t count = tokens_count(tokens);
    require(tokens_reload(tokens, &error) == STATUS_OK && tokens_count(tokens) == count);
    require(!tokens_find(tokens, "", &principal) || principal.scopes);
    tokens_close(tokens);
}

/* A file without a name; its path. */
static int make_file(const char *text, size_t bytes, char path[PATH_BYTES]) {
    int fd = memfd_create("fuzz", 0);
    require(fd >= 0 && write(fd, text, bytes) == (ssize_t)bytes);
    snprintf(path, PATH_BYTES, "/proc/self/fd/%d", fd);
    return fd;
}

static void try_file(const char *text, size_t bytes, bool tokens) {
    char path[PATH_BYTES], program[] = "whittled", flag[] = "--config", *argv[] = {program, flag, path, NULL};
    int fd = make_file(text, bytes, path);
    if (tokens)
        try_tokens(path);
    else
        try_config(3, argv, NULL);
    close(fd);
}

static void try_lines(char *text, bool environment) {
    char program[] = "whittled", *lines[MAX_LINES + 2] = {program}, *rest = NULL;
    int count = 1;
    for (char *line = strtok_r(text, "\n", &rest); line && count <= MAX_LINES; line = strtok_r(NULL, "\n", &rest))
        lines[count++] = line;
    if (environment)
        try_config(1, lines, lines + 1);
    else
        try_config(count, lines, NULL);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    char *text = malloc(size + 1);
    require(text != NULL);
    memcpy(text, data, size);
    text[size] = 0;
    char *newline = memchr(text, '\n', size);
    if (newline) {
        size_t bytes = size - (size_t)(newline + 1 - text);
        *newline = 0;
        if (strcmp(text, "file") == 0 || strcmp(text, "tokens") == 0)
            try_file(newline + 1, bytes, text[0] == 't');
        else if (strcmp(text, "flags") == 0 || strcmp(text, "environment") == 0)
            try_lines(newline + 1, text[0] == 'e');
    }
    free(text);
    return 0;
}
