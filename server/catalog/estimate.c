/* Estimates: for each kind of job the rates (seconds for each point) of the latest ones, and their median.
 *
 * A kind is a hash of what makes jobs alike.  Kinds are kept in a table of fixed size; the one that was learned from
 * longest ago gives way to a new one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/estimate.h"

#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

enum { KINDS = 64, SAMPLES = 16, VALUE_BYTES = PARAMS_TEXT_BYTES };
static const double ALIKE = 4; /* sizes up to this factor apart */
static const double OWN_PACE_FROM = 0.2;

struct sample {
    double size, seconds;
    int64_t finished_ms;
};

struct kind {
    uint64_t hash;
    int64_t latest_ms;
    size_t count;
    struct sample sample[SAMPLES];
};

struct estimate {
    pthread_mutex_t lock;
    size_t count;
    struct kind kind[KINDS];
};

struct estimate *estimate_new(void) {
    struct estimate *estimate = calloc(1, sizeof *estimate);
    if (estimate) pthread_mutex_init(&estimate->lock, NULL);
    return estimate;
}

void estimate_free(struct estimate *estimate) {
    if (!estimate) return;
    pthread_mutex_destroy(&estimate->lock);
    free(estimate);
}

/* ------------------------------------------------------------------------------------------------ kinds */

/* FNV-1a. */
static uint64_t add_text(uint64_t hash, const char *text) {
    do hash = (hash ^ (unsigned char)*text) * 1099511628211u;
    while (*text++);
    return hash;
}

/* Parameters that don't make a job another kind. */
static bool is_degree(const struct param *param) {
    static const char *const names[] = {"ratio",   "points",        "max_error", "levels",  "seed",     "encoding",
                                        "colours", "pcd_precision", "header",    "columns", "viewpoint"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (strcmp(param->name, names[i]) == 0) return true;
    return !param->affects_result;
}

/* The share of points to keep as a power of two; 1 = not known. */
static int kept_step(const struct job *job) {
    const struct params *params = &job->params;
    double ratio = params->levels.count ? params->levels.ratio[0] : params->ratio;
    if (params->points && job->input_points) ratio = (double)params->points / (double)job->input_points;
    return ratio > 0 && ratio <= 1 ? (int)floor(log2(ratio)) : 1;
}

struct job_cost estimate_cost(const struct job *job) {
    size_t count;
    const struct param *table = params_table(&count);
    uint64_t hash = add_text(14695981039346656037u, job->input_format);
    for (size_t i = 0; i < count; i++) {
        char value[VALUE_BYTES];
        if (is_degree(&table[i])) continue;
        params_format(&job->params, &table[i], value, sizeof value);
        hash = add_text(hash, value);
    }
    hash = (hash ^ (uint64_t)kept_step(job)) * 1099511628211u;
    hash = (hash ^ job->params.levels.count) * 1099511628211u;
    return (struct job_cost){.kind = hash, .size = job->input_points ? job->input_points : job->input_bytes};
}

static struct kind *find_kind(struct estimate *estimate, uint64_t hash) {
    for (size_t i = 0; i < estimate->count; i++)
        if (estimate->kind[i].hash == hash) return &estimate->kind[i];
    return NULL;
}

static struct kind *make(struct estimate *estimate, uint64_t hash) {
    struct kind *kind = &estimate->kind[0];
    if (estimate->count < KINDS) {
        kind = &estimate->kind[estimate->count++];
    } else {
        for (size_t i = 1; i < KINDS; i++)
            if (estimate->kind[i].latest_ms < kind->latest_ms) kind = &estimate->kind[i];
    }
    *kind = (struct kind){.hash = hash};
    return kind;
}

/* ------------------------------------------------------------------------------------------------ learning */

void estimate_learn(struct estimate *estimate, const struct job_cost *cost, double seconds, int64_t finished_ms) {
    if (!(seconds > 0) || !cost->size) return;
    pthread_mutex_lock(&estimate->lock);
    struct kind *kind = find_kind(estimate, cost->kind);
    if (!kind) kind = make(estimate, cost->kind);
    size_t at = kind->count;
    if (at < SAMPLES) {
        kind->count++;
    } else {
        at = 0;
        for (size_t i = 1; i < SAMPLES; i++)
            if (kind->sample[i].finished_ms < kind->sample[at].finished_ms) at = i;
    }
    bool older = at < kind->count && kind->count == SAMPLES && kind->sample[at].finished_ms > finished_ms;
    if (!older) kind->sample[at] = (struct sample){(double)cost->size, seconds, finished_ms};
    if (finished_ms > kind->latest_ms) kind->latest_ms = finished_ms;
    pthread_mutex_unlock(&estimate->lock);
}

static int by_value(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

double estimate_seconds(struct estimate *estimate, const struct job_cost *cost) {
    double rate[SAMPLES], size = (double)cost->size;
    size_t count = 0;
    pthread_mutex_lock(&estimate->lock);
    const struct kind *kind = find_kind(estimate, cost->kind);
    for (size_t i = 0; kind && i < kind->count; i++) {
        const struct sample *sample = &kind->sample[i];
        if (sample->size <= ALIKE * size && size <= ALIKE * sample->size)
            rate[count++] = sample->seconds / sample->size;
    }
    pthread_mutex_unlock(&estimate->lock);
    if (count < ESTIMATE_MIN_SAMPLES) return NAN;
    qsort(rate, count, sizeof *rate, by_value);
    return size * (rate[(count - 1) / 2] + rate[count / 2]) / 2;
}

/* ------------------------------------------------------------------------------------------------ looking ahead */

double estimate_assign(double *workers, unsigned count, double seconds) {
    unsigned first = 0;
    for (unsigned i = 0; i < count; i++) {
        if (isnan(workers[i])) return NAN; /* which one is free first isn't known either */
        if (workers[i] < workers[first]) first = i;
    }
    workers[first] += seconds;
    return workers[first];
}

double estimate_rest(double expected_s, double elapsed_s, double fraction) {
    if (elapsed_s < expected_s) return expected_s - elapsed_s;
    if (fraction < OWN_PACE_FROM || fraction > 1) return NAN;
    return elapsed_s * (1 - fraction) / fraction;
}
