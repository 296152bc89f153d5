/* SPDX-License-Identifier: GPL-2.0 */
/* Fake Intel 5300 cards: shared by cards.c (below the driver) and air.c (towards user space). */
#ifndef FAKECARD_H
#define FAKECARD_H

#include <linux/types.h>

#define CARDS 4
#define LONGEST_FRAME 2400

struct card;
struct sk_buff;
struct iwl_tx_cmd;

/* Header of a frame read from /dev/fakecard. */
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
/* Passes a packet to the driver as the transport's receive path does; may sleep. */
int deliver(unsigned int card, const void *packet, size_t len);

/* air.c */
void on_air(struct air_head *head, const struct sk_buff *skb);

/* patched.c: a packet passed to the driver. */
void as_patched(const u8 *packet, size_t len);

#endif
