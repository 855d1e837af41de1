/* The report of a job as JSON: report.json, and the member "report" of the job document.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_REPORT_JSON_H
#define WHITTLE_API_CODECS_REPORT_JSON_H

#include <jansson.h>

#include "core/base/status.h"
#include "core/params.h"
#include "core/report.h"

/* Returns a new reference, or NULL when memory runs out.  Lengths come as they are and, with _rel, as fractions of the
 * diagonal; what wasn't measured is absent. */
json_t *report_json(const struct report *report);

/* Writes {"version", "params", "report"...} indented, with a newline at the end, to fd.  STATUS_IO, STATUS_NO_MEMORY.
 */
enum status report_json_write(int fd, const struct report *report, const struct params *params,
                              struct error *error) MUST_CHECK;

#endif
