// SPDX-License-Identifier: GPL-2.0
/*
 * Turns the sounding frames that monitor interfaces hear into the CSI driver's records, without a
 * card: one "card" per interface, each on its own connector index.
 *
 * sudo insmod csi5300_heard.ko interfaces=wlan0,wlan1 idx=26,25; see tests/kernel/guest/20-sounding.sh.
 *
 * A frame with the magic MAC as addresses 1 and 2 that was received (not a copy of a sent one, not a tx status) becomes a
 * 0xC1 with the frame and a good FCS, followed by the stock 0xBB or, with wsr=1, the WSR driver's 0xBB, with
 * addr3 and the number in it. The number determines the CSI bytes: byte i of frame n is (31 n + i) mod 256. Each
 * card has its own clock: the host's microseconds plus an offset.
 *
 * GPL (version 2), unlike the rest of the project: only such modules may use the connector's functions.
 */
#include <linux/connector.h>
#include <linux/crc32.h>
#include <linux/if_arp.h>
#include <linux/ktime.h>
#include <linux/module.h>
#include <linux/netdevice.h>
#include <linux/rtnetlink.h>
#include <linux/skbuff.h>
#include <linux/slab.h>

#define CARDS 4
#define CN_VAL_IWLAGN 0x1
#define RX_MPDU 0xc1
#define BFEE_NOTIF 0xbb
#define HEADER 24
#define FCS 4
#define LONGEST 512
#define CSI 192 /* 3 chains, 1 stream */
#define TX_FLAGS_BIT 15

static char *interfaces[CARDS];
static unsigned int cards;
module_param_array(interfaces, charp, &cards, 0444);
MODULE_PARM_DESC(interfaces, "monitor interfaces, each a card");

static unsigned int idx[CARDS];
static unsigned int indices;
module_param_array(idx, uint, &indices, 0444);
MODULE_PARM_DESC(idx, "connector index of each card's records; the first one is registered as iwlagn");

static bool wsr;
module_param(wsr, bool, 0444);
MODULE_PARM_DESC(wsr, "records in the WSR driver's layout");

static unsigned int refused;
module_param(refused, uint, 0444);
MODULE_PARM_DESC(refused, "records that the connector refused");

struct card {
	struct packet_type tap;
	struct net_device *dev;
	u16 bfee_count;
	u8 frame[LONGEST + FCS];
};

static struct card taps[CARDS];
static struct cb_id id = { .val = CN_VAL_IWLAGN };
static const u8 magic[12] = { 0x00, 0x16, 0xea, 0x12, 0x34, 0x56, 0x00, 0x16, 0xea, 0x12, 0x34, 0x56 };

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

static void send(unsigned int k, u8 code, const u8 *body, u16 len)
{
	struct cn_msg *msg = kmalloc(sizeof(*msg) + 1 + len, GFP_ATOMIC);

	if (!msg) {
		refused++;
		return;
	}
	memset(msg, 0xa5, sizeof(*msg));
	msg->id.idx = idx[k];
	msg->id.val = CN_VAL_IWLAGN;
	msg->seq = 0;
	msg->len = 1 + len;
	msg->data[0] = code;
	memcpy(msg->data + 1, body, len);
	if (cn_netlink_send(msg, 0, idx[k], GFP_ATOMIC))
		refused++;
	kfree(msg);
}

static void send_bfee(unsigned int k, const u8 *frame, u32 number)
{
	u8 body[38 + CSI];
	u16 header = wsr ? 38 : 20;
	u32 us = (u32)ktime_to_us(ktime_get());
	struct timespec64 now;
	u16 i;

	memset(body, 0, sizeof(body));
	put32(body, us + 1000003u * k);
	put16(body + 4, ++taps[k].bfee_count);
	body[8] = 3;
	body[9] = 1;
	body[10] = 33;
	body[11] = 32;
	body[12] = 31;
	body[13] = 129; /* noise -127: not measured */
	body[14] = 40;
	body[15] = 0x24;
	put16(body + 16, CSI);
	put16(body + 18, 0x0101);
	if (wsr) {
		ktime_get_real_ts64(&now);
		put32(body + 20, (u32)now.tv_sec);
		put32(body + 24, (u32)(now.tv_nsec / 1000));
		memcpy(body + 28, frame + 16, 6);
		put32(body + 34, number);
	}
	for (i = 0; i < CSI; i++)
		body[header + i] = 31 * number + i;
	send(k, BFEE_NOTIF, body, header + CSI);
}

static int heard(struct sk_buff *skb, struct net_device *dev, struct packet_type *tap, struct net_device *origin)
{
	unsigned int k = container_of(tap, struct card, tap) - taps;
	u8 *frame = taps[k].frame;
	u8 radiotap[8];
	u16 start, len;
	u32 number;

	if (skb->pkt_type == PACKET_OUTGOING || skb_copy_bits(skb, 0, radiotap, sizeof(radiotap)))
		goto done;
	/* A copy with TX flags is the tx status of a frame sent here. */
	if (radiotap[4 + TX_FLAGS_BIT / 8] & (1 << TX_FLAGS_BIT % 8))
		goto done;
	start = radiotap[2] | radiotap[3] << 8;
	if (skb->len < start + HEADER + 4 || skb->len - start > LONGEST)
		goto done;
	len = skb->len - start;
	if (skb_copy_bits(skb, start, frame, len) || frame[0] != 0x08 || memcmp(frame + 4, magic, sizeof(magic)))
		goto done;
	number = (u32)frame[24] << 24 | frame[25] << 16 | frame[26] << 8 | frame[27];
	if (!wsr) {
		put32(frame + len, ~crc32_le(~0, frame, len));
		send(k, RX_MPDU, frame, len + FCS);
	}
	send_bfee(k, frame, number);
done:
	kfree_skb(skb);
	return NET_RX_SUCCESS;
}

static void unused(struct cn_msg *msg, struct netlink_skb_parms *parms)
{
}

/* Releases one interface, or all of them if dev is NULL. The caller holds the RTNL. */
static void untap(const struct net_device *dev)
{
	unsigned int k;

	for (k = 0; k < CARDS; k++) {
		if (!taps[k].dev || (dev && taps[k].dev != dev))
			continue;
		dev_remove_pack(&taps[k].tap);
		dev_put(taps[k].dev);
		taps[k].dev = NULL;
	}
}

/* An interface cannot go away before it is released. */
static int interface_event(struct notifier_block *block, unsigned long event, void *info)
{
	if (event == NETDEV_UNREGISTER)
		untap(netdev_notifier_info_to_dev(info));
	return NOTIFY_DONE;
}

static struct notifier_block interface_events = { .notifier_call = interface_event };

static int __init heard_init(void)
{
	unsigned int k;
	int error;

	if (!cards || cards != indices)
		return -EINVAL;
	id.idx = idx[0];
	error = cn_add_callback(&id, "iwlagn", unused);
	if (error)
		return error;
	error = register_netdevice_notifier(&interface_events);
	if (error)
		goto no_notifier;
	rtnl_lock();
	for (k = 0; k < cards; k++) {
		struct net_device *dev = dev_get_by_name(&init_net, interfaces[k]);

		if (!dev || dev->type != ARPHRD_IEEE80211_RADIOTAP) {
			if (dev)
				dev_put(dev);
			untap(NULL);
			error = -ENODEV;
			break;
		}
		taps[k].dev = dev;
		taps[k].tap.type = htons(ETH_P_ALL);
		taps[k].tap.dev = dev;
		taps[k].tap.func = heard;
		dev_add_pack(&taps[k].tap);
	}
	rtnl_unlock();
	if (!error)
		return 0;
	unregister_netdevice_notifier(&interface_events);
no_notifier:
	cn_del_callback(&id);
	return error;
}

static void __exit heard_exit(void)
{
	unregister_netdevice_notifier(&interface_events);
	rtnl_lock();
	untap(NULL);
	rtnl_unlock();
	cn_del_callback(&id);
}

module_init(heard_init);
module_exit(heard_exit);
MODULE_LICENSE("GPL");
MODULE_DESCRIPTION("Sounding frames heard on monitor interfaces, as records of the CSI driver");
