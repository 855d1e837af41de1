/* What records are made of.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/cells.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void copy_text(const struct catalog_cells *cells, int column, char *to, size_t bytes) {
    snprintf(to, bytes, "%s", cells->text(cells->row, column));
}

void catalog_cells_read_job(const struct catalog_cells *cells, struct job *job) {
    int c = 0;
    memset(job, 0, sizeof *job);
    copy_text(cells, c++, job->id, sizeof job->id);
    job->state = (enum job_state)cells->integer(cells->row, c++);
    job->sequence = (uint64_t)cells->integer(cells->row, c++);
    job->attempt = (int)cells->integer(cells->row, c++);
    int64_t *const times[] = {&job->created_ms, &job->started_ms, &job->finished_ms, &job->updated_ms,
                              &job->expires_ms};
    for (size_t i = 0; i < sizeof times / sizeof *times; i++) *times[i] = cells->integer(cells->row, c++);
    copy_text(cells, c++, job->label, sizeof job->label);
    copy_text(cells, c++, job->cloud, sizeof job->cloud);
    job->input_bytes = (uint64_t)cells->integer(cells->row, c++);
    job->input_points = (uint64_t)cells->integer(cells->row, c++);
    copy_text(cells, c++, job->input_format, sizeof job->input_format);
    job->is_strange = !job_params_read(cells->text(cells->row, c++), &job->params);
    copy_text(cells, c++, job->stage, sizeof job->stage);
    copy_text(cells, c++, job->message, sizeof job->message);
    job->fraction = cells->real(cells->row, c++);
    job->cpu_s = cells->real(cells->row, c++);
    job->wall_s = cells->real(cells->row, c++);
    job->peak_rss_bytes = (uint64_t)cells->integer(cells->row, c++);
    job->report = cells->new_text(cells->row, c++);
    job->problem = cells->new_text(cells->row, c++);
    copy_text(cells, c++, job->principal, sizeof job->principal);
    job->priority = (int)cells->integer(cells->row, c++);
    copy_text(cells, c++, job->result, sizeof job->result);
    job->memory_bytes = (uint64_t)cells->integer(cells->row, c++);
    job->failures = (int)cells->integer(cells->row, c++);
    job->interruptions = (int)cells->integer(cells->row, c++);
    copy_text(cells, c++, job->owner, sizeof job->owner);
    job->lease_end_ms = cells->integer(cells->row, c++);
    job->is_cancelled = cells->integer(cells->row, c++) != 0;
    job->tiles = cells->integer(cells->row, c++);
    job->tiles_done = cells->integer(cells->row, c++);
    copy_text(cells, c, job->batch, sizeof job->batch);
    job->task = JOB_TASK_NONE;
    if (job->tiles && job->state == JOB_ACCEPTED && job->started_ms) job->state = JOB_RUNNING;
}

void catalog_cells_read_output(const struct catalog_cells *cells, struct job *job) {
    struct job_output *output = &job->output[job->output_count++];
    copy_text(cells, 0, output->name, sizeof output->name);
    output->bytes = (uint64_t)cells->integer(cells->row, 1);
    copy_text(cells, 2, output->sha256, sizeof output->sha256);
}

void catalog_cells_read_task(const struct catalog_cells *cells, struct job *task) {
    *task = (struct job){.task = cells->integer(cells->row, 1),
                         .attempt = (int)cells->integer(cells->row, 2),
                         .lease_end_ms = cells->integer(cells->row, 4),
                         .failures = (int)cells->integer(cells->row, 5),
                         .interruptions = (int)cells->integer(cells->row, 6)};
    copy_text(cells, 0, task->id, sizeof task->id);
    copy_text(cells, 3, task->owner, sizeof task->owner);
}

void catalog_cells_read_upload(const struct catalog_cells *cells, struct catalog_upload *upload) {
    memset(upload, 0, sizeof *upload);
    copy_text(cells, 0, upload->id, sizeof upload->id);
    copy_text(cells, 1, upload->principal, sizeof upload->principal);
    copy_text(cells, 2, upload->metadata, sizeof upload->metadata);
    copy_text(cells, 3, upload->cloud, sizeof upload->cloud);
    upload->created_ms = cells->integer(cells->row, 4);
    upload->expires_ms = cells->integer(cells->row, 5);
    upload->offset = (uint64_t)cells->integer(cells->row, 6);
    upload->length = (uint64_t)cells->integer(cells->row, 7); /* -1 is UINT64_MAX */
    copy_text(cells, 8, upload->boot, sizeof upload->boot);
    copy_text(cells, 9, upload->concat, sizeof upload->concat);
}

void catalog_cells_read_cloud(const struct catalog_cells *cells, struct catalog_cloud *cloud) {
    memset(cloud, 0, sizeof *cloud);
    copy_text(cells, 0, cloud->sha256, sizeof cloud->sha256);
    cloud->created_ms = cells->integer(cells->row, 1);
    cloud->expires_ms = cells->integer(cells->row, 2);
    cloud->bytes = (uint64_t)cells->integer(cells->row, 3);
    cloud->points = (uint64_t)cells->integer(cells->row, 4);
    copy_text(cells, 5, cloud->format, sizeof cloud->format);
    cloud->jobs = (uint64_t)cells->integer(cells->row, 6);
    cloud->report = cells->new_text(cells->row, 7);
}

bool catalog_cells_read_batch(const struct catalog_cells *cells, struct catalog_batch *batch) {
    memset(batch, 0, sizeof *batch);
    copy_text(cells, 0, batch->id, sizeof batch->id);
    copy_text(cells, 1, batch->principal, sizeof batch->principal);
    copy_text(cells, 2, batch->label, sizeof batch->label);
    batch->created_ms = cells->integer(cells->row, 3);
    int64_t size = cells->integer(cells->row, 4);
    batch->size = size < 1 ? 1 : size > CATALOG_MAX_BATCH ? CATALOG_MAX_BATCH : (size_t)size;
    batch->job = calloc(batch->size, sizeof *batch->job);
    return batch->job != NULL;
}

bool catalog_cells_read_batch_job(const struct catalog_cells *cells, struct catalog_batch *batch) {
    if (batch->job_count == batch->size) return false;
    struct catalog_batch_job *job = &batch->job[batch->job_count++];
    copy_text(cells, 0, job->id, sizeof job->id);
    job->state = (enum job_state)cells->integer(cells->row, 1);
    job->sequence = (uint64_t)cells->integer(cells->row, 2);
    job->fraction = cells->real(cells->row, 3);
    job->finished_ms = cells->integer(cells->row, 4);
    copy_text(cells, 5, job->cloud, sizeof job->cloud);
    return true;
}

void catalog_cells_read_row(const struct catalog_cells *cells, enum catalog_table_name table, struct catalog_row *row) {
    const struct catalog_table *shape = &catalog_tables[table];
    *row = (struct catalog_row){.table = table};
    for (size_t i = 0; i < catalog_table_columns(shape); i++) {
        if (shape->column[i].type == CATALOG_INTEGER) row->cell[i].integer = cells->integer(cells->row, (int)i);
        if (shape->column[i].type == CATALOG_REAL) row->cell[i].real = cells->real(cells->row, (int)i);
        if (shape->column[i].type == CATALOG_TEXT) row->cell[i].text = cells->new_text(cells->row, (int)i);
    }
}
