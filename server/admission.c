/* Admission by prediction.
 *
 * The number of points of a text is a guess from its first lines (core/memory.h, which guesses on the high side), so
 * for the limit of points a fifth is taken off: nobody is refused for a guess that is a little too high.  Memory is
 * what core/memory.h predicts for the job; a refusal says what would fit, a smaller part to keep or a smaller cloud.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/admission.h"

#include <math.h>
#include <stdio.h>

#include "core/cloud_sniff.h"
#include "core/memory.h"

enum { STEPS = 40 };
static const double SMALLEST_RATIO = 0.001;

static uint64_t sure_points(const struct memory_job *job, bool is_text) {
    return is_text ? job->points - job->points / 5 : job->points;
}

static bool refuse_points(const struct admission *admission, uint64_t points, struct problem *problem) {
    problem_set(problem, PROBLEM_TOO_MANY_POINTS, "the cloud has %llu points, more than %llu",
                (unsigned long long)points, (unsigned long long)admission->max_points);
    problem_add_number(problem, "limit", (int64_t)admission->max_points);
    problem_add_number(problem, "actual", (int64_t)points);
    problem_add_text(problem, "hint", "thin the cloud out first, or send parts of it");
    return false;
}

/* What the job takes with a part of the points, keeping a part of those. */
static uint64_t predict(const struct admission *admission, const struct memory_job *job, double part, double ratio) {
    struct memory_job less = *job;
    struct params params = admission->params;
    less.points = (uint64_t)((double)job->points * part);
    less.faces = (uint64_t)((double)job->faces * part);
    less.input_bytes = (uint64_t)((double)job->input_bytes * part);
    if (ratio > 0) params.ratio = ratio, params.points = 0, params.levels.count = 0;
    return memory_predict(&less, &params);
}

/* The largest x in (0, 1) with which the job fits, as the part of the points or, of all, as the ratio; 0: none. */
static double largest(const struct admission *admission, const struct memory_job *job, bool as_ratio) {
    double low = 0, high = 1;
    for (int i = 0; i < STEPS; i++) {
        double x = (low + high) / 2;
        uint64_t bytes = as_ratio ? predict(admission, job, 1, x) : predict(admission, job, x, 0);
        *(bytes <= admission->max_memory_bytes ? &low : &high) = x;
    }
    return low;
}

static bool refuse_memory(const struct admission *admission, const struct memory_job *job, uint64_t bytes,
                          struct problem *problem) {
    char hint[PROBLEM_TEXT_BYTES];
    double ratio = largest(admission, job, true), part = largest(admission, job, false);
    problem_set(problem, PROBLEM_WOULD_EXCEED_MEMORY, "the job would take about %llu MiB, and may take %llu",
                (unsigned long long)(bytes >> 20), (unsigned long long)(admission->max_memory_bytes >> 20));
    problem_add_number(problem, "limit", (int64_t)admission->max_memory_bytes);
    problem_add_number(problem, "actual", bytes > INT64_MAX ? INT64_MAX : (int64_t)bytes);
    if (ratio >= SMALLEST_RATIO)
        snprintf(hint, sizeof hint, "ratio=%.3f would fit", floor(ratio * 1000) / 1000);
    else
        snprintf(hint, sizeof hint, "about %llu points would fit: thin the cloud out first, or leave the mesh out",
                 (unsigned long long)(part * (double)job->points));
    problem_add_text(problem, "hint", hint);
    return false;
}

bool admission_check(const struct admission *admission, const void *first_bytes, size_t n, uint64_t total_bytes,
                     uint64_t *memory_bytes, struct problem *problem) {
    struct memory_job job;
    *memory_bytes = 0;
    if (memory_job_of(first_bytes, n, total_bytes, &job) != STATUS_OK) return true;
    bool is_text = cloud_sniff(first_bytes, n).kind == CLOUD_KIND_TEXT;
    if (total_bytes == UINT64_MAX && is_text) return true;
    if (total_bytes == UINT64_MAX) job.input_bytes = 0;
    uint64_t points = sure_points(&job, is_text);
    if (points > admission->max_points) return refuse_points(admission, points, problem);
    if (!admission->has_params) return true;
    uint64_t bytes = memory_predict(&job, &admission->params);
    if (bytes > admission->max_memory_bytes) return refuse_memory(admission, &job, bytes, problem);
    *memory_bytes = bytes;
    return true;
}
