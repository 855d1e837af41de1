/* The tables of the database, step by step.
 *
 * The schema's version is `user_version`, the number of its steps.  To change it: append a step, never edit one; each
 * step runs once, in order.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/schema.h"

static const char *const steps[] = {
    "CREATE TABLE jobs (id TEXT PRIMARY KEY, state INTEGER NOT NULL, sequence INTEGER NOT NULL, "
    "attempt INTEGER NOT NULL, created INTEGER NOT NULL, started INTEGER NOT NULL, finished INTEGER NOT NULL, "
    "updated INTEGER NOT NULL, expires INTEGER NOT NULL, label TEXT NOT NULL, cloud TEXT NOT NULL, "
    "input_bytes INTEGER NOT NULL, input_points INTEGER NOT NULL, input_format TEXT NOT NULL, params TEXT NOT NULL, "
    "stage TEXT NOT NULL DEFAULT '', message TEXT NOT NULL DEFAULT '', fraction REAL NOT NULL DEFAULT 0, "
    "cpu REAL NOT NULL DEFAULT 0, wall REAL NOT NULL DEFAULT 0, rss INTEGER NOT NULL DEFAULT 0, report TEXT, "
    "problem TEXT) STRICT;"
    "CREATE INDEX jobs_by_state ON jobs (state, id);"
    "CREATE INDEX jobs_by_label ON jobs (label, id);"
    "CREATE INDEX jobs_by_cloud ON jobs (cloud);"
    "CREATE INDEX jobs_by_expiry ON jobs (expires);"
    "CREATE TABLE outputs (job TEXT NOT NULL, position INTEGER NOT NULL, name TEXT NOT NULL, bytes INTEGER NOT NULL, "
    "sha256 TEXT NOT NULL, PRIMARY KEY (job, position)) STRICT, WITHOUT ROWID;"
    "CREATE TABLE tombstones (id TEXT PRIMARY KEY, reason TEXT NOT NULL, at INTEGER NOT NULL) STRICT;",
    "ALTER TABLE jobs ADD COLUMN principal TEXT NOT NULL DEFAULT '';"
    "ALTER TABLE tombstones ADD COLUMN principal TEXT NOT NULL DEFAULT '';"
    "CREATE INDEX jobs_by_principal ON jobs (principal, id);",
    "CREATE TABLE clouds (sha256 TEXT NOT NULL, principal TEXT NOT NULL, created INTEGER NOT NULL, "
    "expires INTEGER NOT NULL, bytes INTEGER NOT NULL, points INTEGER NOT NULL, format TEXT NOT NULL, "
    "PRIMARY KEY (sha256, principal)) STRICT, WITHOUT ROWID;"
    "CREATE INDEX clouds_by_expiry ON clouds (expires);"
    "CREATE INDEX clouds_by_principal ON clouds (principal);",
    "ALTER TABLE jobs ADD COLUMN priority INTEGER NOT NULL DEFAULT 5;"
    "ALTER TABLE jobs ADD COLUMN result TEXT NOT NULL DEFAULT '';"
    "CREATE INDEX jobs_by_result ON jobs (result, id) WHERE result <> '';",
    "CREATE TABLE replies (principal TEXT NOT NULL, key TEXT NOT NULL, fingerprint TEXT NOT NULL, made TEXT NOT NULL, "
    "at INTEGER NOT NULL, status INTEGER NOT NULL DEFAULT 0, etag TEXT NOT NULL DEFAULT '', reply TEXT, "
    "PRIMARY KEY (principal, key)) STRICT, WITHOUT ROWID;"
    "CREATE INDEX replies_by_age ON replies (at);",
    "CREATE TABLE usage (principal TEXT PRIMARY KEY, active INTEGER NOT NULL, bytes INTEGER NOT NULL) STRICT;"
    "INSERT INTO usage SELECT principal, sum(active), sum(bytes) FROM "
    "(SELECT principal, state IN (0, 1) AS active, input_bytes AS bytes FROM jobs "
    "UNION ALL SELECT jobs.principal, 0, outputs.bytes FROM outputs JOIN jobs ON jobs.id = outputs.job "
    "UNION ALL SELECT principal, 0, bytes FROM clouds) GROUP BY principal;"
    "CREATE TRIGGER usage_job_new AFTER INSERT ON jobs BEGIN "
    "INSERT INTO usage VALUES (NEW.principal, NEW.state IN (0, 1), NEW.input_bytes) ON CONFLICT (principal) "
    "DO UPDATE SET active = active + excluded.active, bytes = bytes + excluded.bytes; END;"
    "CREATE TRIGGER usage_job_changed AFTER UPDATE OF state ON jobs BEGIN UPDATE usage SET "
    "active = active + (NEW.state IN (0, 1)) - (OLD.state IN (0, 1)) WHERE principal = NEW.principal; END;"
    "CREATE TRIGGER usage_job_gone AFTER DELETE ON jobs BEGIN UPDATE usage SET "
    "active = active - (OLD.state IN (0, 1)), bytes = bytes - OLD.input_bytes WHERE principal = OLD.principal; END;"
    "CREATE TRIGGER usage_output_new AFTER INSERT ON outputs BEGIN UPDATE usage SET bytes = bytes + NEW.bytes "
    "WHERE principal = (SELECT principal FROM jobs WHERE id = NEW.job); END;"
    "CREATE TRIGGER usage_output_gone AFTER DELETE ON outputs BEGIN UPDATE usage SET bytes = bytes - OLD.bytes "
    "WHERE principal = (SELECT principal FROM jobs WHERE id = OLD.job); END;"
    "CREATE TRIGGER usage_cloud_new AFTER INSERT ON clouds BEGIN "
    "INSERT INTO usage VALUES (NEW.principal, 0, NEW.bytes) ON CONFLICT (principal) "
    "DO UPDATE SET bytes = bytes + excluded.bytes; END;"
    "CREATE TRIGGER usage_cloud_gone AFTER DELETE ON clouds BEGIN "
    "UPDATE usage SET bytes = bytes - OLD.bytes WHERE principal = OLD.principal; END;",
    "CREATE TABLE uploads (id TEXT PRIMARY KEY, principal TEXT NOT NULL, metadata TEXT NOT NULL, cloud TEXT NOT NULL, "
    "created INTEGER NOT NULL, expires INTEGER NOT NULL, position INTEGER NOT NULL, length INTEGER NOT NULL, "
    "boot TEXT NOT NULL) STRICT;",
    "ALTER TABLE jobs ADD COLUMN memory INTEGER NOT NULL DEFAULT 0;",
    "CREATE TABLE outbox (job TEXT PRIMARY KEY, url TEXT NOT NULL, attempts INTEGER NOT NULL DEFAULT 0, "
    "due INTEGER NOT NULL DEFAULT 0) STRICT;"
    "CREATE INDEX outbox_by_due ON outbox (due) WHERE due > 0;",
    "CREATE TABLE identity (one INTEGER PRIMARY KEY CHECK (one = 1), id TEXT NOT NULL) STRICT;",
    ("ALTER TABLE jobs ADD COLUMN failures INTEGER NOT NULL DEFAULT 0;"
     "ALTER TABLE jobs ADD COLUMN interruptions INTEGER NOT NULL DEFAULT 0;"),
    ("ALTER TABLE jobs ADD COLUMN owner TEXT NOT NULL DEFAULT '';"
     "ALTER TABLE jobs ADD COLUMN lease INTEGER NOT NULL DEFAULT 0;"
     "ALTER TABLE jobs ADD COLUMN cancelled INTEGER NOT NULL DEFAULT 0;"),
    "ALTER TABLE outbox ADD COLUMN owner TEXT NOT NULL DEFAULT '';",
    /* Jobs in tiles; a job of these without tasks has none yet. */
    ("ALTER TABLE jobs ADD COLUMN tiles INTEGER NOT NULL DEFAULT 0;"
     "ALTER TABLE jobs ADD COLUMN tiles_done INTEGER NOT NULL DEFAULT 0;"
     "CREATE TABLE tasks (job TEXT NOT NULL, number INTEGER NOT NULL, state INTEGER NOT NULL DEFAULT 0, "
     "attempt INTEGER NOT NULL DEFAULT 0, owner TEXT NOT NULL DEFAULT '', lease INTEGER NOT NULL DEFAULT 0, "
     "failures INTEGER NOT NULL DEFAULT 0, interruptions INTEGER NOT NULL DEFAULT 0, "
     "PRIMARY KEY (job, number)) STRICT, WITHOUT ROWID;"
     "CREATE INDEX tasks_running ON tasks (owner) WHERE state = 1;"),
    /* Batches: their webhook is due when the last job has ended, and they go with the last one. */
    ("ALTER TABLE jobs ADD COLUMN batch TEXT NOT NULL DEFAULT '';"
     "CREATE INDEX jobs_by_batch ON jobs (batch, id) WHERE batch <> '';"
     "CREATE TABLE batches (id TEXT PRIMARY KEY, principal TEXT NOT NULL, label TEXT NOT NULL, "
     "created INTEGER NOT NULL, size INTEGER NOT NULL) STRICT;"
     "CREATE TRIGGER batch_job_ended AFTER UPDATE OF state ON jobs WHEN NEW.batch <> '' AND OLD.state < 2 "
     "AND NEW.state > 1 AND NOT EXISTS (SELECT 1 FROM jobs WHERE batch = NEW.batch AND batch <> '' AND state < 2) "
     "BEGIN UPDATE outbox SET due = NEW.finished WHERE job = NEW.batch; END;"
     "CREATE TRIGGER batch_job_gone AFTER DELETE ON jobs WHEN OLD.batch <> '' "
     "AND NOT EXISTS (SELECT 1 FROM jobs WHERE batch = OLD.batch AND batch <> '') BEGIN "
     "DELETE FROM batches WHERE id = OLD.batch; DELETE FROM outbox WHERE job = OLD.batch; END;"),
    "ALTER TABLE uploads ADD COLUMN concat TEXT NOT NULL DEFAULT '';",
    "CREATE TABLE removals (cloud TEXT PRIMARY KEY, begun INTEGER NOT NULL) STRICT;",
    "CREATE TABLE marks (name TEXT PRIMARY KEY, until INTEGER NOT NULL) STRICT;",
};
enum { VERSION = sizeof steps / sizeof steps[0] };

int schema_version(void) { return VERSION; }

enum status schema_migrate(struct sql *sql, struct error *error) { return sql_migrate(sql, steps, VERSION, error); }
