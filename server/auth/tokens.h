/* Bearer tokens: a file that says which token is whose, and what it may do.
 *
 *     # one line for each token
 *     alice:submit,read:9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08
 *
 * Name, scopes (submit, read, admin) and the SHA-256 of the token, in hexadecimal; '#' begins a comment.  Several lines
 * may have the same name, so that a token can be replaced without a gap.  Tokens themselves are stored nowhere: make
 * them long and random (`openssl rand -hex 32`), so that their hashes tell nothing.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_AUTH_TOKENS_H
#define WHITTLE_SERVER_AUTH_TOKENS_H

#include <stdbool.h>

#include "core/base/status.h"
#include "server/auth/principal.h"

struct tokens;

enum { TOKENS_MAX = 10000, TOKENS_MAX_BYTES = 512 };

/* Reads the file.  STATUS_BAD_PARAMETER, with the line, when it is malformed or names no token; STATUS_IO when it can't
 * be read.  tokens_close accepts NULL. */
enum status tokens_open(const char *path, struct tokens **tokens, struct error *error) MUST_CHECK;
void tokens_close(struct tokens *tokens);

/* Reads the file again; on failure what was there stays. */
enum status tokens_reload(struct tokens *tokens, struct error *error) MUST_CHECK;

/* How many there are. */
size_t tokens_count(struct tokens *tokens);

/* Whose token this is; false: nobody's.  Takes as long for any token of the same length.  From any thread. */
bool tokens_find(struct tokens *tokens, const char *token, struct principal *principal);

#endif
