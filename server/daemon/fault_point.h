/* The setting `fault`: what a test wants to go wrong.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_DAEMON_FAULT_POINT_H
#define WHITTLE_SERVER_DAEMON_FAULT_POINT_H

#include "core/base/status.h"

/* Takes POINT=ACTION, or POINT=ACTION:N for the N-th time that the point is passed, or POINT=ACTION:N-M: ACTION is kill
 * (this process gets SIGKILL), hang (who passes it stays there) or the failure there, enospc, eio, emfile, enomem,
 * enosys, erofs.  Several are separated by commas; "" does nothing.  Before there are other threads. */
enum status fault_arm(const char *text, struct error *error) MUST_CHECK;

#endif
