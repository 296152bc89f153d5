/* SPDX-License-Identifier: GPL-2.0 */
/*
 * Makes the records of csitool's or the WSR driver from the packets of the stock driver. Values are little-endian;
 * offsets count from a packet's data.
 *
 * 0xC0 (RX_PHY), at least 60 bytes: kept, with byte 60 (the antenna order) if byte 1 (cfg_phy_cnt) is not 0. A shorter
 * one is bad_phy, and discards the one before.
 * 0xC1 (MPDU): count, frame with FCS at 4, then status. Sent unchanged if connector_log has 0x4. A frame of 32 bytes or
 * more with good CRC and queue sets sender (address 3) and number (big-endian at 24) of the WSR layout; number 0 clears
 * the sender, as in the WSR driver.
 * 0xBB: header of 20 bytes and CSI. It is bad_bfee unless it has 1 to 3 chains and streams and 60 n_rx n_tx + 12 bytes. It
 * uses up the 0xC0 before it: a second 0xBB, or one without a 0xC0, is no_phy.
 * From 0xC0: time stamp (u32 at 4), antenna order (0xff: unknown), rate (bits 13..0 of the word at 52), RSSI A and B
 * (bits 7..0 and 23..16 of the word at 28), RSSI C (bits 7..0 at 32), AGC (bits 15..9 at 24).
 * bfee_count counts from 1; noise is -127. Bytes 6 to 9, 16, 17 and the CSI are the firmware's.
 * WSR: host time of the 0xBB, sender and number of the last good frame since the 0xC0, else zeros.
 * ALIVE (0x01, the firmware started) clears 0xC0 and sender.
 *
 * Plain C without the kernel, so that a test can compile it: the including file defines u8, u16, u32, bool, memcpy and
 * memset. The Rust crate driver-iface (stock) does the same; a test compares the two byte by byte.
 */
#ifndef CSI5300_RECORDS_H
#define CSI5300_RECORDS_H

#define REPLY_ALIVE 0x01
#define REPLY_TX 0x1c
#define BFEE_NOTIF 0xbb
#define RX_PHY 0xc0
#define RX_MPDU 0xc1
#define PHY_LEN 60       /* struct iwl_rx_phy_res */
#define BFEE_HEADER 20   /* struct iwl_bfee_notif */
#define WSR_HEADER 38
#define LONGEST_FRAME 8191
#define LOG_BFEE 0x1     /* bits of connector_log */
#define LOG_MPDU 0x4
#define NO_ORDER 0xff    /* unknown */
#define NO_NOISE 0x81    /* -127: not measured */
#define CRC_GOOD 0x3     /* RX_RES_STATUS_NO_CRC32_ERROR, _NO_RXE_OVERFLOW */

enum { LAYOUT_STOCK, LAYOUT_WSR };

#define COUNTS(X) X(phy) X(mpdu) X(bfee) X(records) X(bad_phy) X(bad_mpdu) X(mpdu_no_phy) X(bad_bfee) X(no_phy) \
	X(no_order) X(no_sender)
#define MEMBER(name) u32 name;
struct counts { COUNTS(MEMBER) };

struct card {
	struct counts counts;
	u16 bfee_count;
	bool has_phy, has_sender, phy_seen;
	u8 phy[PHY_LEN], order;
	u8 sender[6];
	u32 number;
};

struct options {
	u8 layout, log;
};

/* A connector message: a code and a body, which is `head` followed by `tail`, bytes of the packet. */
struct message {
	u8 code;
	u16 head_len;
	u8 head[WSR_HEADER];
	const u8 *tail;
	u32 tail_len;
};

static u16 get16(const u8 *from)
{
	return from[0] | from[1] << 8;
}

static u32 get32(const u8 *from)
{
	return get16(from) | (u32)get16(from + 2) << 16;
}

static void put16(u8 *to, u16 value)
{
	to[0] = value & 0xff;
	to[1] = value >> 8;
}

static void put32(u8 *to, u32 value)
{
	put16(to, value & 0xffff);
	put16(to + 2, value >> 16);
}

static void take_phy(struct card *card, const u8 *data, u32 len)
{
	card->counts.phy++;
	card->has_sender = false;
	card->has_phy = len >= PHY_LEN;
	if (!card->has_phy) {
		card->counts.bad_phy++;
		return;
	}
	card->phy_seen = true;
	memcpy(card->phy, data, PHY_LEN);
	card->order = data[1] > 0 && len >= PHY_LEN + 4 ? data[PHY_LEN] : NO_ORDER;
}

/* The frame of a 0xC1 (header to FCS) and its length; 0 if its count contradicts the packet's. */
static u32 frame_of(const u8 *data, u32 len, const u8 **frame)
{
	u32 count = len < 8 ? 0 : get16(data);

	*frame = data + 4;
	return count < 14 || count > LONGEST_FRAME || count + 8 > len ? 0 : count;
}

static bool frame_good(const u8 *frame, u32 count)
{
	return (get32(frame + count) & CRC_GOOD) == CRC_GOOD;
}

static bool take_mpdu(struct card *card, const struct options *options, const u8 *data, u32 len, struct message *out)
{
	u32 count = frame_of(data, len, &out->tail);

	card->counts.mpdu++;
	if (!count) {
		card->counts.bad_mpdu++;
		card->has_sender = false;
		return false;
	}
	if (!card->phy_seen) {
		card->counts.mpdu_no_phy++;
		return false;
	}
	if (count >= 32 && frame_good(out->tail, count)) {
		const u8 *number = out->tail + 24;

		card->number = (u32)number[0] << 24 | number[1] << 16 | number[2] << 8 | number[3];
		/* The WSR driver's flag for a known sender is the number itself. */
		if (card->number)
			memcpy(card->sender, out->tail + 16, sizeof(card->sender));
		else
			memset(card->sender, 0, sizeof(card->sender));
		card->has_sender = true;
	}
	out->code = RX_MPDU;
	out->head_len = 0;
	out->tail_len = count;
	return options->log & LOG_MPDU;
}

static void fill_record(const struct card *card, const u8 *data, u8 *record)
{
	u32 agc = get32(card->phy + 24), ab = get32(card->phy + 28), c = get32(card->phy + 32);

	memcpy(record, data, BFEE_HEADER);
	put32(record, get32(card->phy + 4));
	put16(record + 4, card->bfee_count);
	record[10] = ab & 0xff;
	record[11] = ab >> 16 & 0xff;
	record[12] = c & 0xff;
	record[13] = NO_NOISE;
	record[14] = agc >> 9 & 0x7f;
	record[15] = card->order;
	put16(record + 18, get32(card->phy + 52) & 0x3fff);
}

static bool take_bfee(struct card *card, const struct options *options, const u8 *data, u32 len, u32 tv_sec, u32 tv_usec,
		      struct message *out)
{
	bool had_phy = card->has_phy, had_sender = card->has_sender;
	u32 csi;

	card->counts.bfee++;
	/* Valid or not, it is the only one of its frame. */
	card->has_phy = false;
	card->has_sender = false;
	if (len < BFEE_HEADER || data[8] < 1 || data[8] > 3 || data[9] < 1 || data[9] > 3) {
		card->counts.bad_bfee++;
		return false;
	}
	csi = 60u * data[8] * data[9] + 12;
	if (get16(data + 16) != csi || len < BFEE_HEADER + csi) {
		card->counts.bad_bfee++;
		return false;
	}
	if (!had_phy) {
		card->counts.no_phy++;
		return false;
	}
	card->counts.records++;
	card->counts.no_order += card->order == NO_ORDER;
	card->bfee_count++;
	fill_record(card, data, out->head);
	out->code = BFEE_NOTIF;
	out->head_len = BFEE_HEADER;
	if (options->layout == LAYOUT_WSR) {
		out->head_len = WSR_HEADER;
		put32(out->head + 20, tv_sec);
		put32(out->head + 24, tv_usec);
		memset(out->head + 28, 0, 10);
		card->counts.no_sender += !had_sender;
		if (had_sender) {
			memcpy(out->head + 28, card->sender, sizeof(card->sender));
			put32(out->head + 34, card->number);
		}
	}
	out->tail = data + BFEE_HEADER;
	out->tail_len = csi;
	return options->log & LOG_BFEE;
}

/* Handles a packet; true if `out` must be sent. */
static bool assemble(struct card *card, const struct options *options, u8 cmd, const u8 *data, u32 len, u32 tv_sec,
		     u32 tv_usec, struct message *out)
{
	switch (cmd) {
	case REPLY_ALIVE: /* the firmware restarted */
		card->has_phy = card->has_sender = card->phy_seen = false;
		return false;
	case RX_PHY:
		take_phy(card, data, len);
		return false;
	case RX_MPDU:
		return take_mpdu(card, options, data, len, out);
	case BFEE_NOTIF:
		return take_bfee(card, options, data, len, tv_sec, tv_usec, out);
	}
	return false;
}

#endif
