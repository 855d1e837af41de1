/* The service's certificate, which can change while it runs.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_TLS_H
#define WHITTLE_SERVER_HTTP_TLS_H

#include <stddef.h>

#include "core/base/status.h"

struct tls;

/* Reads certificate chain and key, PEM both.  STATUS_BAD_PARAMETER, with the file, when one is malformed or they don't
 * belong together; STATUS_IO when one can't be read.  There is one at a time.  tls_close accepts NULL; no connection is
 * served any more then. */
enum status tls_open(const char *certificate, const char *key, struct tls **tls, struct error *error) MUST_CHECK;
void tls_close(struct tls *tls);

/* Reads both again, for connections that begin from now on; on failure what was there stays. */
enum status tls_reload(struct tls *tls, struct error *error) MUST_CHECK;

/* A gnutls_certificate_retrieve_function2: gives a handshake the certificate
 * of the tls that is open. */
void *tls_retrieve_function(void);

/* What is negotiated: TLS 1.2 and newer, with forward secrecy and authenticated encryption. */
extern const char tls_priorities[];

/* Sends what is the last over a session of GnuTLS', as much of it as goes at once. */
void tls_send_last(void *session, const void *bytes, size_t count);

#endif
