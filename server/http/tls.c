/* The certificate, by GnuTLS.
 *
 * GnuTLS asks for the certificate at each handshake and uses it until the connection ends, without a reference of its
 * own: so a certificate that was replaced is kept until the service ends.  There are as many as there were reloads.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/tls.h"

#include <gnutls/abstract.h>
#include <gnutls/gnutls.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "server/base/setting_file.h"

/* Forward secrecy and authenticated encryption alone: no key exchange by RSA, and no CBC, in TLS 1.2 either. */
const char tls_priorities[] =
    "NORMAL:-VERS-ALL:+VERS-TLS1.3:+VERS-TLS1.2:-KX-ALL:+ECDHE-ECDSA:+ECDHE-RSA:-GROUP-DH-ALL:"
    "-CIPHER-ALL:+AES-256-GCM:+CHACHA20-POLY1305:+AES-128-GCM:-MAC-ALL:+AEAD";

enum { CHAIN_MAX = 16 };

struct generation {
    gnutls_pcert_st chain[CHAIN_MAX];
    unsigned count;
    gnutls_privkey_t key;
    struct generation *older;
};

struct tls {
    char *certificate_path, *key_path;
    struct generation *latest;
};

static struct generation *_Atomic served; /* GnuTLS' callback has no context of ours */

static void free_generation(struct generation *generation) {
    for (unsigned i = 0; i < generation->count; i++) gnutls_pcert_deinit(&generation->chain[i]);
    if (generation->key) gnutls_privkey_deinit(generation->key);
    free(generation);
}

static enum status refused(int rc, const char *setting, const char *path, struct error *error) {
    return error_set(error, STATUS_BAD_PARAMETER, setting, "%.200s: %s", path, gnutls_strerror(rc));
}

/* The file's content; free_text frees it. */
static enum status read_text(const char *setting, const char *path, gnutls_datum_t *text, struct error *error) {
    char *bytes = NULL;
    size_t count = 0;
    enum status status = setting_file_read(setting, path, &bytes, &count, error);
    if (status == STATUS_OK) *text = (gnutls_datum_t){(unsigned char *)bytes, (unsigned)count};
    return status;
}

/* And leaves nothing of a key in memory. */
static void free_text(gnutls_datum_t *text) {
    if (text->data) gnutls_memset(text->data, 0, text->size);
    free(text->data);
}

static enum status read_chain(const struct tls *tls, struct generation *generation, struct error *error) {
    gnutls_datum_t text = {0};
    enum status status = read_text("tls-cert", tls->certificate_path, &text, error);
    unsigned count = CHAIN_MAX;
    if (status != STATUS_OK) return status;
    int rc = gnutls_pcert_list_import_x509_raw(generation->chain, &count, &text, GNUTLS_X509_FMT_PEM,
                                               GNUTLS_X509_CRT_LIST_FAIL_IF_UNSORTED);
    if (rc == 0) generation->count = count;
    free_text(&text);
    return rc == 0 ? STATUS_OK : refused(rc, "tls-cert", tls->certificate_path, error);
}

static enum status read_key(const struct tls *tls, struct generation *generation, struct error *error) {
    gnutls_datum_t text = {0};
    enum status status = read_text("tls-key", tls->key_path, &text, error);
    if (status != STATUS_OK) return status;
    int rc = gnutls_privkey_init(&generation->key);
    if (rc == 0) rc = gnutls_privkey_import_x509_raw(generation->key, &text, GNUTLS_X509_FMT_PEM, NULL, 0);
    free_text(&text);
    return rc == 0 ? STATUS_OK : refused(rc, "tls-key", tls->key_path, error);
}

/* Whether the key is the certificate's: their public halves are the same. */
static enum status check_pair(const struct tls *tls, const struct generation *generation, struct error *error) {
    unsigned char a[64], b[64];
    size_t a_bytes = sizeof a, b_bytes = sizeof b;
    gnutls_pubkey_t public = NULL;
    int rc = gnutls_pubkey_init(&public);
    if (rc == 0) rc = gnutls_pubkey_import_privkey(public, generation->key, 0, 0);
    if (rc == 0) rc = gnutls_pubkey_get_key_id(public, GNUTLS_KEYID_USE_SHA256, a, &a_bytes);
    if (rc == 0) rc = gnutls_pubkey_get_key_id(generation->chain[0].pubkey, GNUTLS_KEYID_USE_SHA256, b, &b_bytes);
    if (public) gnutls_pubkey_deinit(public);
    if (rc != 0) return refused(rc, "tls-key", tls->key_path, error);
    if (a_bytes == b_bytes && memcmp(a, b, a_bytes) == 0) return STATUS_OK;
    return error_set(error, STATUS_BAD_PARAMETER, "tls-key", "%.200s is not the key of %.200s", tls->key_path,
                     tls->certificate_path);
}

enum status tls_reload(struct tls *tls, struct error *error) {
    struct generation *generation = calloc(1, sizeof *generation);
    if (!generation) return error_set(error, STATUS_NO_MEMORY, "tls", "no memory");
    enum status status = read_chain(tls, generation, error);
    if (status == STATUS_OK) status = read_key(tls, generation, error);
    if (status == STATUS_OK) status = check_pair(tls, generation, error);
    if (status != STATUS_OK) {
        free_generation(generation);
        return status;
    }
    generation->older = tls->latest;
    tls->latest = generation;
    atomic_store(&served, generation);
    return STATUS_OK;
}

enum status tls_open(const char *certificate, const char *key, struct tls **tls, struct error *error) {
    struct tls *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "tls", "no memory");
    opened->certificate_path = strdup(certificate);
    opened->key_path = strdup(key);
    enum status status = opened->certificate_path && opened->key_path
                             ? tls_reload(opened, error)
                             : error_set(error, STATUS_NO_MEMORY, "tls", "no memory");
    if (status == STATUS_OK)
        *tls = opened;
    else
        tls_close(opened);
    return status;
}

void tls_close(struct tls *tls) {
    if (!tls) return;
    atomic_store(&served, NULL);
    for (struct generation *g = tls->latest, *older; g; g = older) {
        older = g->older;
        free_generation(g);
    }
    free(tls->certificate_path);
    free(tls->key_path);
    free(tls);
}

static int retrieve(gnutls_session_t session, const gnutls_datum_t *authorities, int authority_count,
                    const gnutls_pk_algorithm_t *algorithms, int algorithm_count, gnutls_pcert_st **chain,
                    unsigned *chain_length, gnutls_privkey_t *key) {
    struct generation *generation = atomic_load(&served);
    (void)session;
    (void)authorities;
    (void)authority_count;
    (void)algorithms;
    (void)algorithm_count;
    if (!generation) return -1;
    *chain = generation->chain;
    *chain_length = generation->count;
    *key = generation->key;
    return 0;
}

void *tls_retrieve_function(void) {
    gnutls_certificate_retrieve_function2 *function = retrieve;
    return (void *)(intptr_t)function;
}

void tls_send_last(void *session, const void *bytes, size_t count) {
    if (gnutls_record_send(session, bytes, count) > 0) gnutls_bye(session, GNUTLS_SHUT_WR);
}
