/* The configuration of whittled, read through its one table.
 *
 * Sources are read from the weakest to the strongest, each overwriting what was set before.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/jobs/config.h"

#include <ctype.h>
#include <errno.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "api/links.h"
#include "api/site.h"
#include "core/base/version.h"
#include "server/base/address.h"
#include "server/base/setting_file.h"
#include "server/blobs/blobs.h"
#include "server/catalog/catalog.h"
#include "server/jobs/descriptors.h"
#include "server/shared/roff.h"

enum kind { TEXT, SWITCH, COUNT, BYTES, DURATION, BASE, HOSTS, ORIGINS, CATALOG, BLOBS, ROLES, ADDRESS, ADMIN_ADDRESS };

/* Beside its kind: a number that is read each time that it is needed, and so may change while the service runs. */
enum { LIVE = 16 };

struct setting {
    const char *name;
    unsigned kind; /* enum kind, and LIVE */
    size_t offset;
    const char *default_text;
    int64_t min, max;
    const char *limit; /* its name in /v1/info; NULL = not shown */
    const char *help;
};

#define AT(member) offsetof(struct config, member)
#define KB INT64_C(1024)
#define GB (KB * KB * KB)
#define SECOND INT64_C(1000)
#define DAY (24 * 3600 * SECOND)

static const struct setting table[] = {
    {"listen", ADDRESS, AT(listen), "127.0.0.1:8080", 0, 0, NULL, "Address and port; port 0 takes a free one"},
    {"data", TEXT, AT(data), "whittled-data", 0, 0, NULL, "Folder for the queue, clouds and outputs"},
    {"catalog", CATALOG, AT(catalog), "", 0, 0, NULL,
     "Where jobs, clouds and uploads are kept, as sqlite:PATH, or postgresql://HOST/DATABASE for several hosts; "
     "default: "
     "sqlite:whittled.db in the data folder"},
    {"blobs", BLOBS, AT(blobs), "", 0, 0, NULL,
     "Where clouds and outputs are kept, as file:PATH, or s3://BUCKET/PREFIX?endpoint=URL with region, keys (a file "
     "with a line access:secret), ca, style (path, or host: the bucket stands in front of the endpoint's host) and "
     "part (objects of more MiB go in parts of so many; default 64); all hosts that share a catalog share it; default: "
     "the data folder"},
    {"roles", ROLES, AT(roles), "http,work", 0, 0, NULL,
     "What this host does of the work: http takes requests, work runs jobs; one of them alone where several hosts "
     "share "
     "a catalog"},
    {"worker", TEXT, AT(worker), "", 0, 0, NULL, "Path of whittle; default: beside this program"},
    {"worker-sandbox", SWITCH, AT(worker_sandbox), "1", 0, 1, NULL,
     "Confine jobs by seccomp, Landlock and namespaces, as far as the kernel has them; limits apply always"},
    {"job-user", TEXT, AT(job_user), "", 0, 0, NULL,
     "Account that jobs run as; takes root or CAP_SETUID, CAP_SETGID, CAP_CHOWN and CAP_KILL; default: the service's "
     "own"},
    {"base-path", BASE, AT(base_path), "", 0, 0, NULL,
     "Path of the service below its host, such as /whittle: links begin with it, requests may"},
    {"allowed-hosts", HOSTS, AT(allowed_hosts), "", 0, 0, NULL,
     "Accepted names in Host besides localhost, addresses and this machine's, separated by commas; "
     "*.NAME: all below it; *: all, the default where there are tokens"},
    {"cors-origins", ORIGINS, AT(cors_origins), "", 0, 0, NULL,
     "Origins of web pages that may use the service, such as https://example.org, separated by commas; *: all"},
    {"config", TEXT, AT(file), "", 0, 0, NULL, "File of settings, lines of name = value"},
    {"insecure-open", SWITCH, AT(insecure_open), "0", 0, 1, NULL, "Allow an address beyond loopback without tokens"},
    {"admin-listen", ADMIN_ADDRESS, AT(admin_listen), "auto", 0, 0, NULL,
     "Address of health and metrics alone; auto: loopback, the port after listen's; off"},
    {"tokens-file", TEXT, AT(tokens_file), "", 0, 0, NULL,
     "File of tokens, lines of name:scopes:sha256; scopes are submit, read, admin, separated by commas"},
    {"tls-cert", TEXT, AT(tls_cert), "", 0, 0, NULL, "File of the certificate chain (PEM), for HTTPS"},
    {"tls-key", TEXT, AT(tls_key), "", 0, 0, NULL, "File of its key (PEM)"},
    {"oneshot-abandon", SWITCH | LIVE, AT(oneshot_abandon), "1", 0, 1, NULL,
     "Dismiss the job of POST /v1/simplify when its client disconnects; 0 = it goes on"},
    {"link-max", DURATION | LIVE, AT(link_max_ms), "7d", SECOND, 3650 * DAY, "link_max_ms",
     "Longest validity of a signed link"},
    {"lease", DURATION, AT(lease_ms), "30s", 100, DAY, NULL,
     "How long a host may be silent before its running jobs are queued again; renewed at a third of it"},
    {"workers", COUNT, AT(workers), "0", 0, 256, "workers", "Jobs that run at the same time; 0 = processors"},
    {"threads-per-job", COUNT | LIVE, AT(threads_per_job), "0", 0, 256, "threads_per_job",
     "Threads of a job whose parameter threads is 0; 0 = processors / workers"},
    {"max-body-bytes", BYTES | LIVE, AT(max_body_bytes), "2G", 1, 1024 * KB *GB, "max_body_bytes",
     "Longest request body"},
    {"max-expansion", COUNT, AT(max_expansion), "250", 1, 1000000, "max_expansion",
     "Bytes that a byte of a compressed body may become, beyond the first 16 MiB"},
    {"max-uploads", COUNT, AT(max_uploads), "1000", 1, 100000, "max_uploads", "Resumable uploads at a time"},
    {"upload-expiry", DURATION, AT(upload_expiry_ms), "24h", 1, 365 * DAY, "upload_expiry_ms",
     "How long a resumable upload is kept after its last piece"},
    {"max-queue", COUNT | LIVE, AT(max_queue), "1000", 1, 1000000, "max_queue", "Jobs that may wait"},
    {"max-points", COUNT, AT(max_points), "2147483647", 1, INT32_MAX, "max_points", "Points of a cloud"},
    {"total-memory", BYTES, AT(total_memory_bytes), "0", 0, 1024 * KB *GB, "total_memory_bytes",
     "Predicted memory of all running jobs, others wait; 0 = physical memory"},
    {"principal-jobs", COUNT | LIVE, AT(principal_jobs), "0", 0, 1000000, "principal_jobs",
     "Jobs of one principal that may wait or run; 0 = no limit of its own"},
    {"principal-uploads", COUNT | LIVE, AT(principal_uploads), "0", 0, 100000, "principal_uploads",
     "Resumable uploads of one principal; 0 = a quarter of max-uploads where there are tokens, else all"},
    {"principal-bytes", BYTES | LIVE, AT(principal_bytes), "0", 0, 1024 * KB *GB, "principal_bytes",
     "Bytes of inputs and outputs that are kept for one principal; 0 = no limit"},
    {"job-memory", BYTES | LIVE, AT(job_memory_bytes), "0", 0, 1024 * KB *GB, "job_memory_bytes",
     "Address space of a job; 0 = physical memory / workers"},
    {"job-cpu", DURATION | LIVE, AT(job_cpu_ms), "1h", SECOND, 365 * DAY, "job_cpu_ms", "Processor time of a job"},
    {"job-wall", DURATION | LIVE, AT(job_wall_ms), "1h", SECOND, 365 * DAY, "job_wall_ms",
     "Time from start to end of a job"},
    {"job-stall", DURATION | LIVE, AT(job_stall_ms), "10m", 0, 365 * DAY, "job_stall_ms",
     "How long a job's process may send nothing and use no processor time, before the job is tried again; 0 = for "
     "ever"},
    {"job-file-bytes", BYTES | LIVE, AT(job_file_bytes), "16G", KB, 1024 * KB *GB, "job_file_bytes",
     "Longest file that a job may write"},
    {"job-write-bytes", BYTES | LIVE, AT(job_write_bytes), "64G", KB, 1024 * KB *GB, "job_write_bytes",
     "What a job may write in all, its log and what it removes again included"},
    {"sync-max", DURATION | LIVE, AT(sync_max_ms), "60s", 1, DAY, "sync_max_ms", "Longest wait of POST /v1/simplify"},
    {"wait-max", DURATION | LIVE, AT(wait_max_ms), "60s", 1, DAY, "wait_max_ms", "Longest wait of a long poll"},
    {"drain-timeout", DURATION | LIVE, AT(drain_timeout_ms), "30s", 0, DAY, NULL,
     "How long running jobs may go on after SIGTERM; then they are queued again"},
    {"retention", DURATION | LIVE, AT(retention_ms), "24h", 1, 3650 * DAY, "retention_ms",
     "How long ended jobs are kept"},
    {"min-free", BYTES | LIVE, AT(min_free_bytes), "256M", 0, 1024 * KB *GB, "min_free_bytes",
     "Uploads are refused when less room would be left on the disk"},
    {"result-cache", SWITCH, AT(result_cache), "1", 0, 1, NULL,
     "Answer the same cloud with the same parameters from the outputs of the earlier job"},
    {"blob-redirect", SWITCH | LIVE, AT(blob_redirect), "0", 0, 1, NULL,
     "Send programs that GET an output or a cloud to the S3 store, by a link that ends after five minutes; clients "
     "must "
     "reach the endpoint of blobs"},
    {"webhooks", SWITCH, AT(webhooks), "0", 0, 1, NULL,
     "Allow webhooks: a POST to an address of the client when its job has ended"},
    {"webhook-secret-file", TEXT, AT(webhook_secret_file), "", 0, 0, NULL,
     "File of the secret that webhooks are signed with, as whsec_ and base64"},
    {"webhook-retry", DURATION, AT(webhook_retry_ms), "5s", 1, DAY, NULL,
     "Pause before the second attempt of a webhook; it doubles with each"},
    {"webhook-allow", TEXT, AT(webhook_allow), "", 0, 0, NULL,
     "Addresses outside the public internet that webhooks may go to, separated by commas"},
    {"idempotency-retention", DURATION, AT(idempotency_retention_ms), "24h", 1, 3650 * DAY, "idempotency_retention_ms",
     "How long an Idempotency-Key is remembered"},
    {"max-connections", COUNT, AT(max_connections), "1000", 8, 100000, "max_connections",
     "Connections at a time; fewer where the limit of open files has no room for three descriptors of each"},
    {"connections-per-address", COUNT, AT(connections_per_address), "200", 1, 100000, "connections_per_address",
     "Connections from one address at a time; with IPv6, from one /64"},
    {"header-timeout", DURATION, AT(header_timeout_ms), "10s", 1, DAY, "header_timeout_ms",
     "How long a new connection may take for its first request's headers; this, idle-timeout and upload-grace are 2 s "
     "while three quarters of max-connections are taken"},
    {"idle-timeout", DURATION, AT(idle_timeout_ms), "60s", SECOND, DAY, "idle_timeout_ms",
     "How long a connection may be silent, or between two requests"},
    {"min-upload-rate", BYTES, AT(min_upload_bytes_per_s), "1K", 0, GB, "min_upload_bytes_per_s",
     "Bytes a second that an upload has to reach, from its first byte on"},
    {"upload-grace", DURATION, AT(upload_grace_ms), "30s", 1, DAY, "upload_grace_ms",
     "How long an upload may be slower than min-upload-rate"},
    {"max-header-bytes", BYTES | LIVE, AT(max_header_bytes), "32K", 1 * KB, 48 * KB, "max_header_bytes",
     "Longest headers of a request, with its first line"},
    {"max-parameters", COUNT | LIVE, AT(max_parameters), "64", 1, 64, "max_parameters", "Parameters in a query"},
    {"refuse-drain-bytes", BYTES | LIVE, AT(refuse_drain_bytes), "64M", 0, 1024 * GB, NULL,
     "How much of a refused body is read before the answer"},
    {"refuse-drain-time", DURATION | LIVE, AT(refuse_drain_ms), "10s", 0, DAY, NULL,
     "How long a refused body is read before the answer"},
    {"fault", TEXT, AT(fault), "", 0, 0, NULL,
     "For tests: where and how to fail, such as commit=kill:3 (server/daemon/fault_point.c)"},
};
enum { ROWS = sizeof table / sizeof table[0] };

static enum kind kind_of(const struct setting *setting) { return (enum kind)(setting->kind & ~(unsigned)LIVE); }

static int64_t *number_of(struct config *config, const struct setting *setting) {
    return (int64_t *)(void *)((char *)config + setting->offset);
}

/* ------------------------------------------------------------------------------------------------ values */

enum { NUMBER_BYTES = 32 }; /* with its unit */

struct unit {
    const char *name;
    int64_t factor;
};
static const struct unit no_units[] = {{"", 1}, {NULL, 0}};
static const struct unit sizes[] = {{"", 1}, {"K", KB}, {"M", KB *KB}, {"G", GB}, {"T", KB *GB}, {NULL, 0}};
static const struct unit durations[] = {{"", SECOND},         {"ms", 1},  {"s", SECOND}, {"m", 60 * SECOND},
                                        {"h", 3600 * SECOND}, {"d", DAY}, {NULL, 0}};

static bool read_number(const char *text, const struct unit *units, int64_t *number) {
    char *end;
    if (text[0] < '0' || text[0] > '9') return false;
    errno = 0;
    long long value = strtoll(text, &end, 10);
    for (; !errno && units->name; units++)
        if (strcmp(units->name, end) == 0) return !__builtin_mul_overflow((int64_t)value, units->factor, number);
    return false;
}

static bool read_switch(const char *text, int64_t *number) {
    static const char *const words[][2] = {{"0", "1"}, {"false", "true"}, {"off", "on"}};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        for (int on = 0; on < 2; on++)
            if (strcmp(text, words[i][on]) == 0) {
                *number = on;
                return true;
            }
    return false;
}

static const struct unit *units_of(enum kind kind) {
    return kind == BYTES ? sizes : kind == DURATION ? durations : no_units;
}

static bool is_text(const struct setting *setting) { return kind_of(setting) == TEXT || kind_of(setting) >= BASE; }

static bool are_roles(const char *text) {
    return strcmp(text, "http,work") == 0 || strcmp(text, "http") == 0 || strcmp(text, "work") == 0;
}

static bool is_address(const char *text) {
    struct address address;
    return address_read(text, &address);
}

static bool is_admin_address(const char *text) {
    return strcmp(text, "auto") == 0 || strcmp(text, "off") == 0 || is_address(text);
}

static bool read_value(struct config *config, const struct setting *setting, const char *text) {
    int64_t number = 0;
    if (kind_of(setting) == BASE && !links_base_valid(text)) return false;
    if (kind_of(setting) == HOSTS && !site_hosts_valid(text)) return false;
    if (kind_of(setting) == CATALOG && text[0] && !catalog_url_valid(text)) return false;
    if (kind_of(setting) == BLOBS && text[0] && !blobs_url_valid(text)) return false;
    if (kind_of(setting) == ROLES && !are_roles(text)) return false;
    if (kind_of(setting) == ADDRESS && !is_address(text)) return false;
    if (kind_of(setting) == ADMIN_ADDRESS && !is_admin_address(text)) return false;
    if (kind_of(setting) == ORIGINS && !site_origins_valid(text)) return false;
    if (is_text(setting)) {
        int n = snprintf((char *)config + setting->offset, CONFIG_TEXT_BYTES, "%s", text);
        return n >= 0 && n < CONFIG_TEXT_BYTES;
    }
    bool ok = kind_of(setting) == SWITCH ? read_switch(text, &number)
                                         : read_number(text, units_of(kind_of(setting)), &number);
    if (!ok || number < setting->min || number > setting->max) return false;
    *number_of(config, setting) = number;
    return true;
}

/* With the largest unit that divides the number, so it is read back as the same.  Returns text. */
static const char *with_unit(const struct setting *setting, int64_t number, char text[NUMBER_BYTES]) {
    const struct unit *units = units_of(kind_of(setting)), *best = units;
    for (const struct unit *unit = units; unit->name; unit++)
        if (number % unit->factor == 0 && (number % best->factor != 0 || (number && unit->factor > best->factor)))
            best = unit;
    snprintf(text, NUMBER_BYTES, "%lld%s", (long long)(number / best->factor), best->name);
    return text;
}

static enum status set(struct config *config, const struct setting *setting, const char *text, struct error *error) {
    static const char *const takes[] = {"a text",
                                        "on or off",
                                        "a whole number",
                                        "a size such as 512M,",
                                        "a duration such as 30s,",
                                        "a path such as /whittle, without a slash at its end",
                                        "names such as whittle.example.org, separated by commas",
                                        "origins such as https://example.org, separated by commas",
                                        "the URL of a catalog such as sqlite:/var/lib/whittled/whittled.db",
                                        "the URL of a blob store such as file:/var/lib/whittled",
                                        "http,work, or http, or work",
                                        "HOST:PORT such as 127.0.0.1:8080 or [::1]:8080, the port from 0 to 65535",
                                        "auto, off, or HOST:PORT such as 127.0.0.1:8081, the port from 0 to 65535"};
    char least[NUMBER_BYTES], most[NUMBER_BYTES], range[2 * NUMBER_BYTES + 16] = "";
    if (read_value(config, setting, text)) return STATUS_OK;
    if (!is_text(setting) && kind_of(setting) != SWITCH)
        snprintf(range, sizeof range, " from %s to %s", with_unit(setting, setting->min, least),
                 with_unit(setting, setting->max, most));
    return error_set(error, STATUS_BAD_PARAMETER, setting->name, "'%.80s' is not allowed; it takes %s%s", text,
                     takes[kind_of(setting)], range);
}

static const struct setting *find(const char *name, size_t length) {
    for (size_t i = 0; i < ROWS; i++)
        if (strlen(table[i].name) == length && strncmp(table[i].name, name, length) == 0) return &table[i];
    return NULL;
}

/* ------------------------------------------------------------------------------------------------ sources */

/* Flags that ask for something else than serving: before the settings are read, or with what was read. */
enum { PRINT_CONFIG = CONFIG_REFUSED + 1, CHECK_CONFIG, HELP, VERSION, MAN };

static const struct {
    const char *flag;
    int action;
    const char *help;
} actions[] = {
    {"--help", HELP, "Tell the settings and their defaults"},
    {"-h", HELP, NULL},
    {"--version", VERSION, "Tell the version"},
    {"--man", MAN, "Print this program's manual page"},
    {"--print-config", PRINT_CONFIG, "Print all settings as they are now, as a file for --config"},
    {"--check-config", CHECK_CONFIG,
     "Read all settings, tokens and the certificate, look up the addresses, and say whether all is allowed; serve "
     "nothing"},
};
enum { ACTIONS = sizeof actions / sizeof actions[0] };

/* CONFIG_RUN where the argument is none of these. */
static int find_action(const char *argument) {
    for (size_t i = 0; i < ACTIONS; i++)
        if (strcmp(argument, actions[i].flag) == 0) return actions[i].action;
    return CONFIG_RUN;
}

static bool asks_for(int action, int argc, char **argv) {
    for (int i = 1; i < argc; i++)
        if (find_action(argv[i]) == action) return true;
    return false;
}

static enum status read_defaults(struct config *config, struct error *error) {
    enum status status = STATUS_OK;
    memset(config, 0, sizeof *config);
    for (size_t i = 0; i < ROWS && status == STATUS_OK; i++)
        status = set(config, &table[i], table[i].default_text, error);
    return status;
}

/* WHITTLED_MAX_QUEUE=5 sets max-queue. */
static enum status read_environment(struct config *config, char **environment, struct error *error) {
    static const char prefix[] = "WHITTLED_";
    enum status status = STATUS_OK;
    for (; environment && *environment && status == STATUS_OK; environment++) {
        const char *equals = strchr(*environment, '=');
        if (!equals || strncmp(*environment, prefix, sizeof prefix - 1) != 0) continue;
        char name[64] = "";
        const char *from = *environment + sizeof prefix - 1;
        for (size_t i = 0; from + i < equals && i + 1 < sizeof name; i++)
            name[i] = from[i] == '_' ? '-' : (char)tolower((unsigned char)from[i]);
        const struct setting *setting = find(name, strlen(name));
        status = setting ? set(config, setting, equals + 1, error)
                         : error_set(error, STATUS_BAD_PARAMETER, name[0] ? name : "WHITTLED_",
                                     "unknown setting in the environment");
    }
    return status;
}

static char *trim(char *text) {
    text += strspn(text, " \t");
    for (size_t n = strlen(text); n && strchr(" \t\r\n", text[n - 1]); n--) text[n - 1] = 0;
    return text;
}

/* A # begins a comment at the start of a line or after a blank, so a value may hold one. */
static void cut_comment(char *line) {
    for (char *hash = strchr(line, '#'); hash; hash = strchr(hash + 1, '#'))
        if (hash == line || strchr(" \t", hash[-1])) {
            *hash = 0;
            return;
        }
}

static enum status read_line(struct config *config, char *line, struct error *error) {
    cut_comment(line);
    line = trim(line);
    if (!line[0]) return STATUS_OK;
    char *equals = strchr(line, '=');
    if (equals) *equals = 0;
    const char *name = trim(line);
    const struct setting *setting = find(name, strlen(name));
    if (!equals || !setting)
        return error_set(error, STATUS_BAD_PARAMETER, name[0] ? name : "config", "unknown setting in the file");
    return set(config, setting, trim(equals + 1), error);
}

static enum status read_file(struct config *config, const char *path, struct error *error) {
    char line[CONFIG_TEXT_BYTES + 64];
    FILE *file;
    enum status status = setting_file_open("config", path, &file, error);
    if (status != STATUS_OK) return status;
    while (status == STATUS_OK && fgets(line, sizeof line, file)) status = read_line(config, line, error);
    fclose(file);
    return status;
}

/* What other programs call it. */
static const char *named_elsewhere(const char *name) {
    static const char *const names[][2] = {{"port", "listen"},     {"host", "listen"},        {"bind", "listen"},
                                           {"address", "listen"},  {"tokens", "tokens-file"}, {"folder", "data"},
                                           {"dir", "data"},        {"database", "catalog"},   {"cors", "cors-origins"},
                                           {"cert", "tls-cert"},   {"key", "tls-key"},        {"jobs", "workers"},
                                           {"threads", "workers"}, {"log", "log-level"},      {"verbose", "log-level"}};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (strcmp(names[i][0], name) == 0) return names[i][1];
    return NULL;
}

static enum status refuse_unknown(const char *flag, size_t length, struct error *error) {
    char name[64];
    const char *names[ROWS + 1] = {NULL};
    for (size_t i = 0; i < ROWS; i++) names[i] = table[i].name;
    snprintf(name, sizeof name, "%.*s", (int)length, flag + 2);
    const char *near = named_elsewhere(name);
    if (!near || !find(near, strlen(near))) near = params_suggest_of(name, names);
    return error_set(error, STATUS_BAD_PARAMETER, flag, "unknown flag; %s%s%ssee --help",
                     near ? "did you mean '--" : "", near ? near : "", near ? "'? " : "");
}

/* One flag, as --name VALUE, --name=VALUE or, for a switch, --name alone.  What follows a switch and is no flag can
 * only be its value.  *i moves on to its last argument. */
static enum status read_flag(struct config *config, int argc, char **argv, int *i, struct error *error) {
    const char *flag = argv[*i];
    if (strncmp(flag, "--", 2) != 0)
        return error_set(error, STATUS_BAD_PARAMETER, flag, "no setting; settings are --name value, see --help");
    size_t length = strcspn(flag + 2, "=");
    const struct setting *setting = find(flag + 2, length);
    if (!setting) return refuse_unknown(flag, length, error);
    if (flag[2 + length] == '=') return set(config, setting, flag + 3 + length, error);
    bool valued = *i + 1 < argc && argv[*i + 1][0] != '-';
    if (kind_of(setting) == SWITCH && !valued) return set(config, setting, "1", error);
    if (*i + 1 == argc) return error_set(error, STATUS_BAD_PARAMETER, flag, "needs a value");
    return set(config, setting, argv[++*i], error);
}

static enum status read_flags(struct config *config, int argc, char **argv, struct error *error) {
    enum status status = STATUS_OK;
    for (int i = 1; i < argc && status == STATUS_OK; i++)
        if (find_action(argv[i]) == CONFIG_RUN) status = read_flag(config, argc, argv, &i, error);
    return status;
}

/* ------------------------------------------------------------------------------------------------ defaults */

static void beside_this_program(char *worker) {
    char path[CONFIG_TEXT_BYTES];
    ssize_t n = readlink("/proc/self/exe", path, sizeof path - 1);
    path[n > 0 ? n : 0] = 0;
    char *slash = strrchr(path, '/');
    if (slash) *slash = 0;
    snprintf(worker, CONFIG_TEXT_BYTES, "%.4000s/whittle", path);
}

static void fill_in(struct config *config) {
    int64_t processors = sysconf(_SC_NPROCESSORS_ONLN);
    int64_t memory = (int64_t)sysconf(_SC_PHYS_PAGES) * sysconf(_SC_PAGESIZE);
    if (processors < 1) processors = 1;
    if (!config->workers) config->workers = processors;
    if (!config->threads_per_job) config->threads_per_job = processors / config->workers;
    if (!config->threads_per_job) config->threads_per_job = 1;
    if (!config->total_memory_bytes) config->total_memory_bytes = memory;
    if (!config->job_memory_bytes) config->job_memory_bytes = memory / config->workers;
    if (!config->principal_uploads)
        config->principal_uploads = config->tokens_file[0] ? (config->max_uploads + 3) / 4 : config->max_uploads;
    if (!config->worker[0]) beside_this_program(config->worker);
    int64_t room = descriptors_connections(config);
    config->wanted_connections = config->max_connections;
    if (config->max_connections > room) config->max_connections = room;
}

/* ------------------------------------------------------------------------------------------------ telling */

static void print_help(void) {
    puts("Usage: whittled [--setting VALUE ...]\n"
         "       whittled healthcheck [--url http://HOST:PORT/PATH] [--setting VALUE ...]\n"
         "       whittled check [--adopt] --data FOLDER\n"
         "       whittled migrate --catalog URL\n"
         "       whittled export --to FOLDER | import --from FOLDER [--setting VALUE ...]\n\n"
         "Serves whittle over HTTP.  Prints the address that it listens on, then logs to standard error.\n"
         "SIGTERM ends it when the running jobs are done; a second one ends it at once.\n"
         "SIGHUP makes it read settings and tokens again.\n"
         "healthcheck asks a running one how it is: exit status 0 = well, 1 = not.\n"
         "check compares database and files of a folder that none serves: 0 = nothing is damaged, 1 = something is, 2 "
         "= it "
         "couldn't be looked at.\n"
         "migrate makes the tables that several hosts share, or brings them up to date.\n"
         "export puts all that a service has into a new data folder, import takes it out of one; nobody may serve "
         "either.\n\nSettings:");
    for (size_t i = 0; i < ROWS; i++)
        printf("  --%-26s%s%s%s%s\n", table[i].name, table[i].help, table[i].default_text[0] ? " (" : "",
               table[i].default_text, table[i].default_text[0] ? ")" : "");
    puts("\nInstead of serving:");
    for (size_t i = 0; i < ACTIONS; i++)
        if (actions[i].help) printf("  %-28s%s\n", actions[i].flag, actions[i].help);
    puts("\nEach setting is also read from the environment: --max-queue from WHITTLED_MAX_QUEUE.");
}

static void print_value(const struct config *config, const struct setting *setting) {
    char number[NUMBER_BYTES];
    if (is_text(setting))
        fputs((const char *)config + setting->offset, stdout);
    else
        fputs(with_unit(setting, *number_of((struct config *)config, setting), number), stdout);
}

/* The file that they were read from isn't named in it. */
static void print_config(const struct config *config) {
    printf("# Settings of whittled %s, as `whittled --print-config` tells them.\n", whittle_version());
    for (size_t i = 0; i < ROWS; i++) {
        if (table[i].offset == AT(file)) continue;
        printf("\n# %s.\n%s = ", table[i].help, table[i].name);
        print_value(config, &table[i]);
        puts("");
    }
}

static void print_man_settings(void) {
    static const char *const takes[] = {[TEXT] = "text",
                                        [SWITCH] = "0 or 1",
                                        [COUNT] = "number",
                                        [BYTES] = "size",
                                        [DURATION] = "duration",
                                        [BASE] = "path",
                                        [HOSTS] = "hosts",
                                        [ORIGINS] = "origins",
                                        [CATALOG] = "URL",
                                        [BLOBS] = "URL",
                                        [ROLES] = "roles",
                                        [ADDRESS] = "address",
                                        [ADMIN_ADDRESS] = "address"};
    for (size_t i = 0; i < ROWS; i++) {
        printf(".TP\n\\fB\\-\\-");
        roff_print(table[i].name);
        printf("\\fR \\fI%s\\fR\n", takes[kind_of(&table[i])]);
        roff_print(table[i].help);
        puts(".");
        if (!table[i].default_text[0]) continue;
        printf("Default: ");
        roff_print(table[i].default_text);
        puts(".");
    }
}

static void print_man(void) {
    printf(".\\\" SPDX-License-Identifier: GPL-3.0-or-later\n.TH WHITTLED 8 \"\" \"whittle %s\" \"whittle\"\n",
           whittle_version());
    puts(".SH NAME\nwhittled \\- simplify point clouds over HTTP\n.SH SYNOPSIS\n.B whittled\n.RI [ "
         "\\-\\-setting\\~value "
         "...]\n.br\n.B whittled healthcheck\n.RI [ \\-\\-url\\~URL ]\n.RI [ \\-\\-setting\\~value ...]\n"
         ".br\n.B whittled check\n.RI [ \\-\\-adopt ]\n.RI \\-\\-data\\~FOLDER\n"
         ".br\n.B whittled migrate\n.RI \\-\\-catalog\\~URL\n.br\n.B whittled export\n.RI \\-\\-to\\~FOLDER\n"
         ".RI [ \\-\\-setting\\~value ...]\n.br\n.B whittled import\n.RI \\-\\-from\\~FOLDER\n"
         ".RI [ \\-\\-setting\\~value ...]\n"
         ".SH DESCRIPTION\nServes\n.BR whittle (1)\nover HTTP: clouds come in, simplified clouds, meshes and measured "
         "errors go out.\nPrints the address that it listens on, then logs to standard error.\n"
         "The service describes itself at /docs and /openapi.json.\n.PP\n"
         "SIGTERM ends it when the running jobs are done; a second one ends it at once.\n"
         "What was accepted is never lost: jobs that were running are queued again.\n.PP\n"
         "A setting comes from its flag, else from the environment, else from the file that\n.B \\-\\-config\nnames, "
         "else from its default.\nWhatever is unknown or out of range ends the start.\n.SH SETTINGS\n"
         "A size takes K, M, G or T (powers of 1024), a duration ms, s, m, h or d.");
    print_man_settings();
    puts(".SH OTHER OPTIONS");
    for (size_t i = 0; i < ACTIONS; i++) {
        if (!actions[i].help) continue;
        printf(".TP\n.B ");
        roff_print(actions[i].flag);
        puts("");
        roff_print(actions[i].help);
        puts(".");
    }
    puts(
        ".SH HEALTHCHECK\n.B whittled healthcheck\nasks the service at the address in the settings, or the one that\n"
        ".B \\-\\-url\nnames, for /healthz.\nExit status 0: it answered that it is well; 1: it did not.\n"
        ".SH CHECK\n.B whittled check\ncompares the database of a folder that no service has with its files, by their "
        "hashes,\nand prints what is damaged (exit status 1), and what a crash left and the next start mends; 2: "
        "nothing could be looked at, as "
        "where a service has the folder.\n"
        "A folder and a database that don't belong together aren't served.  Put the folder's own database back, from a "
        "backup;\nwhere there is none,\n.B \\-\\-adopt\nmakes them belong together, and the next start moves what "
        "the database doesn't know to lost+found in the folder.\n"
        ".SH MIGRATE, EXPORT, IMPORT\n.B whittled migrate\nmakes the tables of a catalog that several hosts share, or "
        "brings them up to date.\n.B whittled export\nputs jobs, clouds, outputs, logs, keys and webhooks of the "
        "catalog "
        "and the blobs in the settings into the data folder\n.BR \\-\\-to ,\n.B whittled import\ntakes them out of the "
        "data "
        "folder\n.BR \\-\\-from .\nNobody may serve either side meanwhile.  What is there already stays as it is, so "
        "either may be run again, and goes on where it was ended.\nResumable uploads that aren't whole stay behind.\n"
        ".SH ENVIRONMENT\nEach setting is read from a variable:\n.B \\-\\-max\\-queue\nfrom\n.BR WHITTLED_MAX_QUEUE .\n"
        ".SH FILES\nThe file of\n.B \\-\\-config\nholds lines of name = value; # begins a comment.\n"
        ".B whittled \\-\\-print\\-config\nwrites one with every setting in it.\n"
        ".SH EXIT STATUS\n0 after SIGTERM, 2 when a setting is wrong, 1 when anything else is.\n"
        ".SH SEE ALSO\n.BR whittle (1),\n.BR curl (1)");
}

/* What comes before anything that may be wrong. */
static bool told(int argc, char **argv) {
    if (asks_for(HELP, argc, argv))
        print_help();
    else if (asks_for(VERSION, argc, argv))
        printf("whittled %s\n", whittle_version());
    else if (asks_for(MAN, argc, argv))
        print_man();
    else
        return false;
    return true;
}

/* Whether there is a port after listen's, where health and metrics are to be there. */
static enum status check_admin_port(const struct config *config, struct error *error) {
    struct address address;
    if (strcmp(config->admin_listen, "auto") != 0 || !address_read(config->listen, &address) ||
        address.port < ADDRESS_MAX_PORT)
        return STATUS_OK;
    return error_set(error, STATUS_BAD_PARAMETER, "admin-listen",
                     "there is no port after listen's, %u; --admin-listen names an address, or off", address.port);
}

enum config_request config_read(struct config *config, int argc, char **argv, char **environment, struct error *error) {
    if (told(argc, argv)) return CONFIG_TOLD;
    struct config flags;
    enum status status = read_defaults(config, error);
    if (status == STATUS_OK) status = read_environment(config, environment, error);
    flags = *config;
    if (status == STATUS_OK) status = read_flags(&flags, argc, argv, error);
    if (status == STATUS_OK && flags.file[0]) {
        status = read_defaults(config, error);
        if (status == STATUS_OK) status = read_file(config, flags.file, error);
        if (status == STATUS_OK) status = read_environment(config, environment, error);
        if (status == STATUS_OK) status = read_flags(config, argc, argv, error);
    } else if (status == STATUS_OK) {
        *config = flags;
    }
    if (status == STATUS_OK) status = check_admin_port(config, error);
    if (status != STATUS_OK) return CONFIG_REFUSED;
    bool prints = asks_for(PRINT_CONFIG, argc, argv), checks = asks_for(CHECK_CONFIG, argc, argv);
    if (prints) {
        print_config(config);
        return CONFIG_TOLD;
    }
    fill_in(config);
    return checks ? CONFIG_CHECK : CONFIG_RUN;
}

static bool same(const struct config *a, const struct config *b, const struct setting *setting) {
    const char *x = (const char *)a + setting->offset, *y = (const char *)b + setting->offset;
    return is_text(setting) ? strcmp(x, y) == 0 : memcmp(x, y, sizeof(int64_t)) == 0;
}

enum status config_reload(const struct config *config, int argc, char **argv, char **environment, struct config *next,
                          void (*tell)(const char *name, bool live), struct error *error) {
    struct config *read = malloc(sizeof *read);
    if (!read) return error_set(error, STATUS_NO_MEMORY, "config", "no memory");
    enum status status =
        config_read(read, argc, argv, environment, error) == CONFIG_RUN ? STATUS_OK : STATUS_BAD_PARAMETER;
    for (size_t i = 0; i < ROWS && status == STATUS_OK; i++) {
        if (i == 0) *next = *config;
        if (same(config, read, &table[i])) continue;
        bool live = table[i].kind & LIVE;
        if (live) *number_of(next, &table[i]) = *number_of(read, &table[i]);
        tell(table[i].name, live);
    }
    free(read);
    return status;
}

bool config_limit(void *config, size_t i, const char **name, int64_t *value) {
    for (size_t row = 0; row < ROWS; row++) {
        if (!table[row].limit || i--) continue;
        *name = table[row].limit;
        *value = *number_of(config, &table[row]);
        return true;
    }
    return false;
}
