/* The tables, step by step.
 *
 * To change them: append a step, never edit one.  Hosts of the version before go on while the next one's step is there
 * already, so a step only adds: tables, columns with a default, indexes.
 *
 * All numbers are BIGINT, times milliseconds since 1970 by the database's clock.  Names are compared by bytes (COLLATE
 * "C"), so that ids sort as they do in memory.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/postgres/tables.h"

static const char *const steps[] = {
    /* What is kept of a job is catalog/job.h; due: since when it waits, less what its priority is worth.  writer: the
     * session that changed it last. */
    "CREATE FUNCTION whittle_now() RETURNS BIGINT LANGUAGE sql VOLATILE AS "
    "$$ SELECT (extract(epoch FROM clock_timestamp()) * 1000)::BIGINT $$;"
    "CREATE TABLE jobs (id TEXT COLLATE \"C\" PRIMARY KEY, state BIGINT NOT NULL, sequence BIGINT NOT NULL, "
    "attempt BIGINT NOT NULL, created BIGINT NOT NULL, started BIGINT NOT NULL, finished BIGINT NOT NULL, "
    "updated BIGINT NOT NULL, expires BIGINT NOT NULL, label TEXT NOT NULL, cloud TEXT COLLATE \"C\" NOT NULL, "
    "input_bytes BIGINT NOT NULL, input_points BIGINT NOT NULL, input_format TEXT NOT NULL, params TEXT NOT NULL, "
    "stage TEXT NOT NULL DEFAULT '', message TEXT NOT NULL DEFAULT '', fraction FLOAT8 NOT NULL DEFAULT 0, "
    "cpu FLOAT8 NOT NULL DEFAULT 0, wall FLOAT8 NOT NULL DEFAULT 0, rss BIGINT NOT NULL DEFAULT 0, report TEXT, "
    "problem TEXT, principal TEXT COLLATE \"C\" NOT NULL, priority BIGINT NOT NULL, result TEXT NOT NULL, "
    "memory BIGINT NOT NULL DEFAULT 0, failures BIGINT NOT NULL DEFAULT 0, interruptions BIGINT NOT NULL DEFAULT 0, "
    "owner TEXT NOT NULL DEFAULT '', lease BIGINT NOT NULL DEFAULT 0, cancelled BIGINT NOT NULL DEFAULT 0, "
    "writer TEXT NOT NULL DEFAULT '', due BIGINT NOT NULL);"
    "CREATE INDEX jobs_waiting ON jobs (principal, due, id) WHERE state = 0;"
    "CREATE INDEX jobs_running ON jobs (owner) WHERE state = 1;"
    "CREATE INDEX jobs_by_state ON jobs (state, id);"
    "CREATE INDEX jobs_by_label ON jobs (label, id);"
    "CREATE INDEX jobs_by_cloud ON jobs (cloud);"
    "CREATE INDEX jobs_by_principal ON jobs (principal, id);"
    "CREATE INDEX jobs_by_expiry ON jobs (expires) WHERE expires > 0;"
    "CREATE INDEX jobs_by_change ON jobs (updated);"
    "CREATE INDEX jobs_by_result ON jobs (result, id) WHERE result <> '';"
    "CREATE TABLE outputs (job TEXT COLLATE \"C\" NOT NULL, position BIGINT NOT NULL, name TEXT NOT NULL, "
    "bytes BIGINT NOT NULL, sha256 TEXT NOT NULL, PRIMARY KEY (job, position));"
    "CREATE TABLE tombstones (id TEXT COLLATE \"C\" PRIMARY KEY, reason TEXT NOT NULL, at BIGINT NOT NULL, "
    "principal TEXT NOT NULL);"
    "CREATE INDEX tombstones_by_age ON tombstones (at);"
    "CREATE TABLE clouds (sha256 TEXT COLLATE \"C\" NOT NULL, principal TEXT COLLATE \"C\" NOT NULL, "
    "created BIGINT NOT NULL, expires BIGINT NOT NULL, bytes BIGINT NOT NULL, points BIGINT NOT NULL, "
    "format TEXT NOT NULL, PRIMARY KEY (sha256, principal));"
    "CREATE INDEX clouds_by_expiry ON clouds (expires);"
    "CREATE INDEX clouds_by_principal ON clouds (principal);"
    "CREATE TABLE uploads (id TEXT COLLATE \"C\" PRIMARY KEY, principal TEXT NOT NULL, metadata TEXT NOT NULL, "
    "cloud TEXT NOT NULL, created BIGINT NOT NULL, expires BIGINT NOT NULL, position BIGINT NOT NULL, "
    "length BIGINT NOT NULL, boot TEXT NOT NULL);"
    "CREATE TABLE replies (principal TEXT COLLATE \"C\" NOT NULL, key TEXT COLLATE \"C\" NOT NULL, "
    "fingerprint TEXT NOT NULL, made TEXT NOT NULL, at BIGINT NOT NULL, status BIGINT NOT NULL DEFAULT 0, "
    "etag TEXT NOT NULL DEFAULT '', reply TEXT, PRIMARY KEY (principal, key));"
    "CREATE INDEX replies_by_age ON replies (at);"
    "CREATE TABLE outbox (job TEXT COLLATE \"C\" PRIMARY KEY, url TEXT NOT NULL, attempts BIGINT NOT NULL DEFAULT 0, "
    "due BIGINT NOT NULL DEFAULT 0, owner TEXT NOT NULL DEFAULT '');"
    "CREATE INDEX outbox_by_due ON outbox (due) WHERE due > 0;"
    /* Clouds that somebody is about to refer to: their bytes stay until then. */
    "CREATE TABLE expected (cloud TEXT COLLATE \"C\" PRIMARY KEY, until BIGINT NOT NULL);"
    "CREATE INDEX expected_by_end ON expected (until);"
    "CREATE TABLE identity (one BIGINT PRIMARY KEY CHECK (one = 1), id TEXT NOT NULL);"
    /* What ends with the process that made it: alive until its lease is over. */
    "CREATE TABLE sessions (id TEXT COLLATE \"C\" PRIMARY KEY, lease BIGINT NOT NULL);"
    "CREATE TABLE holds (principal TEXT COLLATE \"C\" NOT NULL, key TEXT COLLATE \"C\" NOT NULL, "
    "session TEXT COLLATE \"C\" NOT NULL, PRIMARY KEY (principal, key));"
    "CREATE TABLE reservations (session TEXT COLLATE \"C\" NOT NULL, principal TEXT COLLATE \"C\" NOT NULL, "
    "bytes BIGINT NOT NULL, PRIMARY KEY (principal, session));"
    /* What each principal has, kept in step by triggers; served: when it had its last turn. */
    "CREATE TABLE usage (principal TEXT COLLATE \"C\" PRIMARY KEY, active BIGINT NOT NULL, bytes BIGINT NOT NULL, "
    "served BIGINT NOT NULL DEFAULT 0);"
    "CREATE SEQUENCE turns;"
    "CREATE FUNCTION whittle_add_usage(who TEXT, more_active BIGINT, more_bytes BIGINT) RETURNS VOID LANGUAGE sql AS "
    "$$ INSERT INTO usage AS u (principal, active, bytes) VALUES (who, more_active, more_bytes) "
    "ON CONFLICT (principal) DO UPDATE SET active = u.active + more_active, bytes = u.bytes + more_bytes $$;"
    "CREATE FUNCTION whittle_job_usage() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN "
    "IF TG_OP = 'INSERT' THEN "
    "PERFORM whittle_add_usage(NEW.principal, (NEW.state IN (0, 1))::INT, NEW.input_bytes); "
    "ELSIF TG_OP = 'DELETE' THEN "
    "PERFORM whittle_add_usage(OLD.principal, -(OLD.state IN (0, 1))::INT, -OLD.input_bytes); "
    "ELSIF (NEW.state IN (0, 1)) <> (OLD.state IN (0, 1)) THEN "
    "PERFORM whittle_add_usage(NEW.principal, (NEW.state IN (0, 1))::INT - (OLD.state IN (0, 1))::INT, 0); "
    "END IF; RETURN NULL; END $$;"
    "CREATE TRIGGER usage_of_jobs AFTER INSERT OR DELETE OR UPDATE OF state ON jobs FOR EACH ROW "
    "EXECUTE FUNCTION whittle_job_usage();"
    "CREATE FUNCTION whittle_output_usage() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN "
    "IF TG_OP = 'INSERT' THEN "
    "PERFORM whittle_add_usage((SELECT principal FROM jobs WHERE id = NEW.job), 0, NEW.bytes); ELSE "
    "PERFORM whittle_add_usage((SELECT principal FROM jobs WHERE id = OLD.job), 0, -OLD.bytes); "
    "END IF; RETURN NULL; END $$;"
    "CREATE TRIGGER usage_of_outputs AFTER INSERT OR DELETE ON outputs FOR EACH ROW "
    "EXECUTE FUNCTION whittle_output_usage();"
    "CREATE FUNCTION whittle_cloud_usage() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN "
    "IF TG_OP = 'INSERT' THEN PERFORM whittle_add_usage(NEW.principal, 0, NEW.bytes); "
    "ELSE PERFORM whittle_add_usage(OLD.principal, 0, -OLD.bytes); END IF; RETURN NULL; END $$;"
    "CREATE TRIGGER usage_of_clouds AFTER INSERT OR DELETE ON clouds FOR EACH ROW "
    "EXECUTE FUNCTION whittle_cloud_usage();",
    "CREATE TABLE secrets (name TEXT PRIMARY KEY, value TEXT NOT NULL);",
    /* How many jobs of each principal wait, so that nobody counts them. */
    "ALTER TABLE usage ADD COLUMN waiting BIGINT NOT NULL DEFAULT 0;"
    "LOCK TABLE jobs IN SHARE ROW EXCLUSIVE MODE;"
    "UPDATE usage SET waiting = counted.waiting FROM (SELECT principal, count(*) AS waiting FROM jobs WHERE state = 0 "
    "GROUP BY principal) AS counted WHERE counted.principal = usage.principal;"
    "CREATE INDEX usage_of_waiting ON usage (served) WHERE waiting > 0;"
    "CREATE OR REPLACE FUNCTION whittle_job_usage() RETURNS TRIGGER LANGUAGE plpgsql AS $$ "
    "DECLARE who TEXT; before BIGINT := 3; later BIGINT := 3; more_bytes BIGINT := 0; BEGIN "
    "IF TG_OP <> 'INSERT' THEN before := OLD.state; who := OLD.principal; more_bytes := -OLD.input_bytes; END IF; "
    "IF TG_OP <> 'DELETE' THEN later := NEW.state; who := NEW.principal; "
    "more_bytes := more_bytes + NEW.input_bytes; END IF; "
    "IF before = later AND more_bytes = 0 THEN RETURN NULL; END IF; "
    "INSERT INTO usage AS u (principal, active, bytes, waiting) "
    "VALUES (who, (later < 2)::INT - (before < 2)::INT, more_bytes, (later = 0)::INT - (before = 0)::INT) "
    "ON CONFLICT (principal) DO UPDATE SET active = u.active + excluded.active, bytes = u.bytes + excluded.bytes, "
    "waiting = u.waiting + excluded.waiting; RETURN NULL; END $$;",
    /* Uploads whose pieces are blobs: writer is who may add one. */
    "ALTER TABLE uploads ADD COLUMN writer TEXT NOT NULL DEFAULT '';"
    "CREATE INDEX uploads_by_principal ON uploads (principal);"
    "CREATE INDEX uploads_by_expiry ON uploads (expires);"
    "CREATE TABLE pieces (upload TEXT COLLATE \"C\" NOT NULL, position BIGINT NOT NULL, bytes BIGINT NOT NULL, "
    "name TEXT NOT NULL, PRIMARY KEY (upload, position));"
    "CREATE TABLE marks (name TEXT COLLATE \"C\" PRIMARY KEY, until BIGINT NOT NULL);"
    "CREATE INDEX marks_by_end ON marks (until);",
    /* How many steps a program must know to go on with these. */
    "ALTER TABLE schema_steps ADD COLUMN oldest BIGINT NOT NULL DEFAULT 0;",
    /* Jobs in tiles; a job of these without tasks has none yet.  It has no owner: a host that doesn't know of tasks
     * would take the job for one in one piece, and changes nothing. */
    "ALTER TABLE jobs ADD COLUMN tiles BIGINT NOT NULL DEFAULT 0;"
    "ALTER TABLE jobs ADD COLUMN tiles_done BIGINT NOT NULL DEFAULT 0;"
    "CREATE TABLE tasks (job TEXT COLLATE \"C\" NOT NULL, number BIGINT NOT NULL, state BIGINT NOT NULL DEFAULT 0, "
    "attempt BIGINT NOT NULL DEFAULT 0, owner TEXT NOT NULL DEFAULT '', lease BIGINT NOT NULL DEFAULT 0, "
    "failures BIGINT NOT NULL DEFAULT 0, interruptions BIGINT NOT NULL DEFAULT 0, PRIMARY KEY (job, number));"
    "CREATE INDEX tasks_running ON tasks (owner) WHERE state = 1;"
    "CREATE FUNCTION whittle_owned_by_none() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN RETURN NULL; END $$;"
    "CREATE TRIGGER jobs_in_tiles BEFORE UPDATE ON jobs FOR EACH ROW WHEN (NEW.tiles <> 0 AND NEW.owner <> '') "
    "EXECUTE FUNCTION whittle_owned_by_none();",
    /* Batches: their webhook is due when the last job has ended, and they go with the last one; whichever host, of
     * whichever version, ends it.  Two that end at once come one after the other, by the batch's row. */
    "ALTER TABLE jobs ADD COLUMN batch TEXT COLLATE \"C\" NOT NULL DEFAULT '';"
    "CREATE INDEX jobs_by_batch ON jobs (batch, id) WHERE batch <> '';"
    "CREATE TABLE batches (id TEXT COLLATE \"C\" PRIMARY KEY, principal TEXT COLLATE \"C\" NOT NULL, "
    "label TEXT NOT NULL, created BIGINT NOT NULL, size BIGINT NOT NULL);"
    "CREATE INDEX batches_by_principal ON batches (principal, id);"
    "CREATE FUNCTION whittle_batch_job_ended() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN "
    "PERFORM 1 FROM batches WHERE id = NEW.batch FOR UPDATE; "
    "UPDATE outbox SET due = whittle_now() WHERE job = NEW.batch AND NOT EXISTS "
    "(SELECT 1 FROM jobs WHERE batch = NEW.batch AND batch <> '' AND state < 2); RETURN NULL; END $$;"
    "CREATE TRIGGER batch_job_ended AFTER UPDATE OF state ON jobs FOR EACH ROW "
    "WHEN (NEW.batch <> '' AND OLD.state < 2 AND NEW.state > 1) EXECUTE FUNCTION whittle_batch_job_ended();"
    "CREATE FUNCTION whittle_batch_job_gone() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN "
    "PERFORM 1 FROM batches WHERE id = OLD.batch FOR UPDATE; "
    "IF NOT EXISTS (SELECT 1 FROM jobs WHERE batch = OLD.batch AND batch <> '') THEN "
    "DELETE FROM outbox WHERE job = OLD.batch; DELETE FROM batches WHERE id = OLD.batch; END IF; "
    "RETURN NULL; END $$;"
    "CREATE TRIGGER batch_job_gone AFTER DELETE ON jobs FOR EACH ROW WHEN (OLD.batch <> '') "
    "EXECUTE FUNCTION whittle_batch_job_gone();",
    "ALTER TABLE uploads ADD COLUMN concat TEXT NOT NULL DEFAULT '';",
    /* Hosts of the version before would remove a batch's webhook, for they find no job of its name, and make a cloud of
     * a part of an upload, or remove it where it is none.  So a batch's webhook is claimed by who raises `claims`: what
     * they claim stays as it is, and they find that they haven't got it.  And a part is written by who is called +...:
     * what they do with one fails as if the server were away, and they answer 503. */
    "ALTER TABLE outbox ADD COLUMN claims BIGINT NOT NULL DEFAULT 0;"
    "CREATE FUNCTION whittle_batch_unknown() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN "
    "IF EXISTS (SELECT 1 FROM batches WHERE id = NEW.job) THEN RETURN NULL; END IF; RETURN NEW; END $$;"
    "CREATE TRIGGER batch_unknown BEFORE UPDATE ON outbox FOR EACH ROW "
    "WHEN (NEW.owner <> '' AND NEW.owner <> OLD.owner AND NEW.claims = OLD.claims) "
    "EXECUTE FUNCTION whittle_batch_unknown();"
    "CREATE FUNCTION whittle_part_unknown() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN "
    "RAISE 'parts of uploads are for a newer whittled' USING ERRCODE = 'cannot_connect_now'; END $$;"
    "CREATE TRIGGER part_unknown_to_writer BEFORE UPDATE ON uploads FOR EACH ROW WHEN (OLD.concat = 'partial' AND "
    "(NEW.cloud <> '' OR (NEW.writer <> OLD.writer AND NEW.writer <> '' AND left(NEW.writer, 1) <> '+'))) "
    "EXECUTE FUNCTION whittle_part_unknown();"
    "CREATE TRIGGER part_unknown_to_deleter BEFORE DELETE ON uploads FOR EACH ROW "
    "WHEN (OLD.concat = 'partial' AND OLD.expires > whittle_now()) EXECUTE FUNCTION whittle_part_unknown();",
    /* Since when the bytes of a cloud are being removed, and whether they are gone.  Meanwhile nobody is about to refer
     * to it, hosts of the version before included: what they do fails as if the server were away.  So does a row of who
     * was about to, and comes when they are gone. */
    "ALTER TABLE expected ADD COLUMN removal BIGINT NOT NULL DEFAULT 0;"
    "ALTER TABLE expected ADD COLUMN removed BIGINT NOT NULL DEFAULT 0;"
    "CREATE FUNCTION whittle_cloud_goes() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN "
    "IF OLD.removed = 0 THEN RAISE 'the cloud is being removed' USING ERRCODE = 'cannot_connect_now'; END IF; "
    "NEW.removal := 0; NEW.removed := 0; RETURN NEW; END $$;"
    "CREATE TRIGGER cloud_goes BEFORE UPDATE ON expected FOR EACH ROW "
    "WHEN (OLD.removal > 0 AND NEW.removal = OLD.removal AND NEW.removed = OLD.removed) "
    "EXECUTE FUNCTION whittle_cloud_goes();"
    "CREATE FUNCTION whittle_cloud_gone() RETURNS TRIGGER LANGUAGE plpgsql AS $$ DECLARE since BIGINT; BEGIN "
    "IF TG_TABLE_NAME = 'jobs' THEN SELECT removal INTO since FROM expected WHERE cloud = NEW.cloud FOR KEY SHARE; "
    "ELSE SELECT removal INTO since FROM expected WHERE cloud = NEW.sha256 FOR KEY SHARE; END IF; "
    "IF since > 0 THEN RAISE 'the cloud was removed meanwhile' USING ERRCODE = 'cannot_connect_now'; END IF; "
    "RETURN NULL; END $$;"
    "CREATE TRIGGER cloud_gone AFTER INSERT ON jobs FOR EACH ROW EXECUTE FUNCTION whittle_cloud_gone();"
    "CREATE TRIGGER cloud_gone AFTER INSERT ON clouds FOR EACH ROW EXECUTE FUNCTION whittle_cloud_gone();",
    /* Hosts of the version before don't know denoise=noisy, which counts where a mesh is made, and don't claim such
     * jobs (who does raises `claims`).  What one host can't run goes behind, or all that it could would wait for
     * another. */
    "ALTER TABLE jobs ADD COLUMN claims BIGINT NOT NULL DEFAULT 0;"
    "CREATE FUNCTION whittle_pass_over(job TEXT) RETURNS VOID LANGUAGE sql AS $$ "
    "UPDATE jobs SET due = 1 + (SELECT max(due) FROM jobs AS o WHERE o.state = 0 AND o.principal = jobs.principal) "
    "WHERE id = job AND state = 0; "
    "UPDATE usage SET served = nextval('turns') WHERE principal = (SELECT principal FROM jobs WHERE id = job) $$;"
    "CREATE OR REPLACE FUNCTION whittle_owned_by_none() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN "
    "IF OLD.state = 0 THEN PERFORM whittle_pass_over(OLD.id); END IF; RETURN NULL; END $$;"
    "CREATE FUNCTION whittle_job_unknown() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN "
    "IF NEW.params ~ '(^|\\n)denoise=noisy(\\n|$)' AND NEW.params ~ '(^|\\n)outputs=[^\\n]*(mesh|error)' THEN "
    "PERFORM whittle_pass_over(OLD.id); RETURN NULL; END IF; RETURN NEW; END $$;"
    "CREATE TRIGGER job_unknown BEFORE UPDATE OF state ON jobs FOR EACH ROW "
    "WHEN (OLD.state = 0 AND NEW.state = 1 AND NEW.claims = OLD.claims) EXECUTE FUNCTION whittle_job_unknown();",
    /* A removal that is begun while the row of who is late isn't committed waits for it: there is something to lock
     * also where nobody is known any more to be about to refer to the cloud. */
    "CREATE OR REPLACE FUNCTION whittle_cloud_gone() RETURNS TRIGGER LANGUAGE plpgsql AS $$ "
    "DECLARE name TEXT; since BIGINT; BEGIN "
    "IF TG_TABLE_NAME = 'jobs' THEN name := NEW.cloud; ELSE name := NEW.sha256; END IF; "
    "LOOP SELECT removal INTO since FROM expected WHERE cloud = name FOR KEY SHARE; EXIT WHEN FOUND; "
    "INSERT INTO expected (cloud, until) VALUES (name, whittle_now()) ON CONFLICT DO NOTHING; END LOOP; "
    "IF since > 0 THEN RAISE 'the cloud was removed meanwhile' USING ERRCODE = 'cannot_connect_now'; END IF; "
    "RETURN NULL; END $$;",
};
enum { STEPS = sizeof steps / sizeof steps[0] };

/* What the version before this one knows; with a new version it becomes what STEPS was. */
enum { OLDEST = 5 };

/* Of the lock that one migration at a time has. */
#define MIGRATION "7741160"

static enum status read_version(struct pq_link *link, int64_t *version, struct error *error) {
    int64_t tables = 0;
    *version = 0;
    enum status status = pq_number(link, "SELECT count(*) FROM pg_class WHERE oid = to_regclass('schema_steps')", NULL,
                                   0, &tables, error);
    if (status == STATUS_OK && tables)
        status = pq_number(link, "SELECT count FROM schema_steps", NULL, 0, version, error);
    return status;
}

enum status tables_check(struct pq_link *link, struct error *error) {
    int64_t version = 0, oldest = INT64_MAX;
    enum status status = read_version(link, &version, error);
    if (status == STATUS_OK && version > STEPS)
        status = pq_number(link, "SELECT oldest FROM schema_steps", NULL, 0, &oldest, error);
    if (status != STATUS_OK || version == STEPS || oldest <= STEPS) return status;
    return error_set(error, STATUS_UNSUPPORTED, "catalog", "the database has schema %lld, this program knows %d; %s",
                     (long long)version, STEPS,
                     version > STEPS ? "it is more than a version newer: run a newer whittled"
                                     : "run whittled migrate");
}

static enum status run_steps(struct pq_link *link, struct error *error) {
    int64_t version = 0;
    enum status status = pq_execute(link, "SELECT pg_advisory_xact_lock(" MIGRATION ")", error);
    if (status == STATUS_OK) status = read_version(link, &version, error);
    if (status != STATUS_OK || version > STEPS) return status == STATUS_OK ? tables_check(link, error) : status;
    if (status == STATUS_OK && !version)
        status = pq_execute(
            link, "CREATE TABLE schema_steps (count BIGINT NOT NULL); INSERT INTO schema_steps VALUES (0)", error);
    for (int64_t i = version; status == STATUS_OK && i < STEPS; i++) status = pq_execute(link, steps[i], error);
    if (status == STATUS_OK)
        status =
            pq_run(link, "UPDATE schema_steps SET count = $1, oldest = $2", VALUES(I(STEPS), I(OLDEST)), NULL, error);
    return status;
}

enum status tables_migrate(struct pq *pq, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(pq, &link, error);
    return status == STATUS_OK ? pq_end(link, run_steps(link, error), NULL, error) : status;
}
