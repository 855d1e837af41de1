/* A stage that runs several times, once for each level, has one row with its times added.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/report.h"

#include <stdio.h>
#include <string.h>

void report_add_stage(struct report *report, const char *name, double wall_ms) {
    size_t i = 0;
    while (i < report->stage_count && strcmp(report->stage[i].name, name) != 0) i++;
    if (i == REPORT_MAX_STAGES) return;
    if (i == report->stage_count) {
        snprintf(report->stage[i].name, sizeof report->stage[i].name, "%s", name);
        report->stage_count++;
    }
    report->stage[i].wall_ms += wall_ms;
}
