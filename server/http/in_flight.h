/* How many exchanges there are, how many of them are parked, how many bring a body; and waiting for their end.  All
 * functions may be called from any thread.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_IN_FLIGHT_H
#define WHITTLE_SERVER_HTTP_IN_FLIGHT_H

#include <pthread.h>
#include <stdbool.h>

struct tally {
    pthread_mutex_t lock;
    pthread_cond_t fewer;
    unsigned parked, exchanges, uploads;
    bool stopping;
};

void tally_init(struct tally *tally);
void tally_done(struct tally *tally);

/* An exchange begins, or ends. */
void tally_begin(struct tally *tally);
void tally_end(struct tally *tally);

/* An exchange is about to be suspended; false: nothing may be any more.  Or it is resumed. */
bool tally_park(struct tally *tally);
void tally_unpark(struct tally *tally);

/* A body begins to come, or has come. */
void tally_upload(struct tally *tally, bool begins);
unsigned tally_uploads(struct tally *tally);

/* Lets nothing park any more; waits until nothing is parked and, for so long at most, until all exchanges have ended.
 */
void tally_stop(struct tally *tally, int patience_s);

#endif
