/* SPDX-License-Identifier: GPL-2.0 */
/* Intel 5300 cards that are not there: what cards.c (below the driver) and air.c (towards user space) share. */
#ifndef FAKECARD_H
#define FAKECARD_H

#include <linux/types.h>

#define CARDS 4
#define LONGEST_FRAME 2400

struct card;
struct sk_buff;
struct iwl_tx_cmd;

/* What is read from /dev/fakecard before a frame. */
struct air_head {
	u8 card, zero;
	__le16 len;
	__le32 rate, flags;
	u8 rts_retries, data_retries;
	__le16 zero2;
	__le64 us;
} __packed;

/* cards.c */
int cards_begin(unsigned int count);
void cards_end(void);
/* A packet into the driver, as the transport's receive path hands it over; it may sleep. */
int deliver(unsigned int card, const void *packet, size_t len);

/* air.c */
void on_air(struct air_head *head, const struct sk_buff *skb);

/* patched.c: a packet that the driver has been given. */
void as_patched(const u8 *packet, size_t len);

#endif
