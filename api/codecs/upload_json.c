/* The document of a resumable upload.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/upload_json.h"

#include <jansson.h>

#include "api/codecs/job_json.h"
#include "api/links.h"

char *upload_encode(const struct upload_document *upload) {
    char created[JOB_JSON_TIME_BYTES], expires[JOB_JSON_TIME_BYTES];
    json_t *length = upload->length == UINT64_MAX ? json_null() : json_integer((json_int_t)upload->length);
    json_t *cloud = upload->cloud[0] ? json_sprintf("%s/v1/clouds/%s", links_base(), upload->cloud) : json_null();
    json_t *json = json_pack("{s:s, s:I, s:o, s:s, s:s, s:s, s:o, s:[{s:s, s:o}]}", "id", upload->id, "offset",
                             (json_int_t)upload->offset, "length", length, "metadata", upload->metadata, "created",
                             job_json_time(upload->created_ms, created), "expires",
                             job_json_time(upload->expires_ms, expires), "cloud", cloud, "links", "rel", "self", "href",
                             json_sprintf("%s/v1/uploads/%s", links_base(), upload->id));
    char *text = json ? json_dumps(json, JSON_COMPACT) : NULL;
    json_decref(json);
    return text;
}
