/* The configuration of whittled: one table for flags, environment, file, --help and the limits in /v1/info.
 *
 * A setting comes from --name VALUE, else from WHITTLED_NAME in the environment, else from the file that --config
 * names (lines of name = value, # begins a comment), else from its default.  Whatever is unknown or out of range ends
 * the start.  Sizes take K, M, G, T (powers of 1024); durations take ms, s, m, h, d (seconds where nothing is said).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_JOBS_CONFIG_H
#define WHITTLE_SERVER_JOBS_CONFIG_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

#include "core/base/status.h"

enum { CONFIG_TEXT_BYTES = 4096 };

/* A member is read by whoever needs it, at any time; SIGHUP puts another struct in place (config_reload). */
struct config {
    char listen[CONFIG_TEXT_BYTES], data[CONFIG_TEXT_BYTES], worker[CONFIG_TEXT_BYTES], file[CONFIG_TEXT_BYTES];
    char job_user[CONFIG_TEXT_BYTES], catalog[CONFIG_TEXT_BYTES], blobs[CONFIG_TEXT_BYTES], roles[CONFIG_TEXT_BYTES];
    char fault[CONFIG_TEXT_BYTES];
    char tokens_file[CONFIG_TEXT_BYTES], admin_listen[CONFIG_TEXT_BYTES];
    char tls_cert[CONFIG_TEXT_BYTES], tls_key[CONFIG_TEXT_BYTES], base_path[CONFIG_TEXT_BYTES];
    char allowed_hosts[CONFIG_TEXT_BYTES], cors_origins[CONFIG_TEXT_BYTES];
    int64_t link_max_ms;
    int64_t oneshot_abandon; /* a switch: a one-shot whose client is gone is dismissed */
    int64_t insecure_open;   /* a switch: 0 or 1 */
    int64_t result_cache;    /* a switch */
    int64_t blob_redirect;   /* a switch: outputs and clouds are fetched at the store, where it gives links */
    int64_t idempotency_retention_ms;
    int64_t webhooks; /* a switch */
    int64_t webhook_retry_ms, lease_ms;
    char webhook_secret_file[CONFIG_TEXT_BYTES], webhook_allow[CONFIG_TEXT_BYTES];
    int64_t worker_sandbox; /* a switch */
    int64_t workers, threads_per_job;
    int64_t max_body_bytes, max_expansion, max_uploads, upload_expiry_ms, max_queue, max_points, job_memory_bytes,
        total_memory_bytes, job_cpu_ms, job_wall_ms, job_stall_ms, job_file_bytes, job_write_bytes;
    int64_t sync_max_ms, wait_max_ms, drain_timeout_ms, retention_ms, min_free_bytes;
    int64_t wanted_connections; /* max-connections as it was set; max_connections is what fits (descriptors.h) */
    int64_t max_connections, connections_per_address, header_timeout_ms, idle_timeout_ms, min_upload_bytes_per_s,
        upload_grace_ms;
    int64_t max_header_bytes, max_parameters, principal_jobs, principal_uploads, principal_bytes;
    int64_t refuse_drain_bytes, refuse_drain_ms;
};

enum config_request {
    CONFIG_RUN,
    CONFIG_TOLD,  /* --help and the like: done */
    CONFIG_CHECK, /* --check-config: what was read is allowed, as far as it goes without looking at what it names */
    CONFIG_REFUSED
};

/* Reads everything; environment is environ-like, NULL-terminated.  What is 0 for "by the machine" (workers, memory and
 * threads of a job) is filled in, and connections that don't fit below the limit of open files are cut off. */
enum config_request config_read(struct config *config, int argc, char **argv, char **environment,
                                struct error *error) MUST_CHECK;

/* Reads everything again, as config_read did, and takes over what may change while the service runs: *next is *config
 * with these settings as they are now.  tell(name, live) is called for each setting that has changed, live or not. */
enum status config_reload(const struct config *config, int argc, char **argv, char **environment, struct config *next,
                          void (*tell)(const char *name, bool live), struct error *error) MUST_CHECK;

/* The i-th limit for /v1/info; false past the last. */
bool config_limit(void *config, size_t i, const char **name, int64_t *value);

#endif
