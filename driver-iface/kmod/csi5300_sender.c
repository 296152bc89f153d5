// SPDX-License-Identifier: GPL-2.0
/*
 * Sends bfee records through the kernel connector as the CSI driver does, without a card.
 *
 * sudo insmod csi5300_sender.ko count=1000 period_us=1000 n_rx=3 n_tx=1; the parameter `sent` counts.
 *
 * It registers as "iwlagn" and sends one message for each record, with sequence number 0 and with `ack` and `flags`
 * left uninitialised; here that memory is filled with 0xa5 first, which exposes a listener that
 * reads them. The body of record k is a bfee whose CSI bytes are (31 k + i) mod 256.
 *
 * GPL (version 2), unlike the rest of the project: only such modules may use the connector's functions.
 */
#include <linux/connector.h>
#include <linux/hrtimer.h>
#include <linux/kthread.h>
#include <linux/ktime.h>
#include <linux/module.h>
#include <linux/slab.h>
#include <linux/version.h>

#define CN_IDX_IWLAGN (CN_NETLINK_USERS + 0xf)
#define CN_VAL_IWLAGN 0x1
#define BFEE_NOTIF 0xbb
#define STOCK_HEADER 20

static unsigned int count = 1000;
module_param(count, uint, 0444);
MODULE_PARM_DESC(count, "records to send");

static unsigned int period_us = 1000;
module_param(period_us, uint, 0444);
MODULE_PARM_DESC(period_us, "microseconds between records; 0 does not wait");

static unsigned int n_rx = 3;
module_param(n_rx, uint, 0444);
MODULE_PARM_DESC(n_rx, "receive chains, 1 to 3");

static unsigned int n_tx = 1;
module_param(n_tx, uint, 0444);
MODULE_PARM_DESC(n_tx, "space-time streams, 1 to 3");

static unsigned int sent;
module_param(sent, uint, 0444);
MODULE_PARM_DESC(sent, "records sent so far");

static unsigned int refused;
module_param(refused, uint, 0444);
MODULE_PARM_DESC(refused, "of these, calls that the connector refused (no listener, or an overrun)");

static struct cb_id id = { .idx = CN_IDX_IWLAGN, .val = CN_VAL_IWLAGN };
static struct task_struct *sender;

static void put16(u8 *to, u16 value)
{
	to[0] = value & 0xff;
	to[1] = value >> 8;
}

static void fill_bfee(u8 *data, u16 k, u16 csi)
{
	u32 timestamp_low = k * 1000u;
	u16 i;

	memset(data, 0, 1 + STOCK_HEADER);
	data[0] = BFEE_NOTIF;
	put16(data + 1, timestamp_low & 0xffff);
	put16(data + 3, timestamp_low >> 16);
	put16(data + 5, k);
	data[9] = n_rx;
	data[10] = n_tx;
	data[11] = 33;
	data[12] = 32;
	data[13] = 31;
	data[14] = 129; /* noise -127: not measured */
	data[15] = 40;
	data[16] = 0x24;
	put16(data + 17, csi);
	put16(data + 19, 0x0101);
	for (i = 0; i < csi; i++)
		data[1 + STOCK_HEADER + i] = 31 * k + i;
}

static int send_one(u16 k)
{
	u16 csi = 60 * n_rx * n_tx + 12;
	u16 len = 1 + STOCK_HEADER + csi;
	struct cn_msg *msg = kmalloc(sizeof(*msg) + len, GFP_KERNEL);
	int answer;

	if (!msg)
		return -ENOMEM;
	memset(msg, 0xa5, sizeof(*msg));
	msg->id = id;
	msg->seq = 0;
	msg->len = len;
	fill_bfee(msg->data, k, csi);
#if LINUX_VERSION_CODE >= KERNEL_VERSION(3, 16, 0)
	answer = cn_netlink_send(msg, 0, id.idx, GFP_KERNEL);
#else
	answer = cn_netlink_send(msg, id.idx, GFP_KERNEL);
#endif
	kfree(msg);
	return answer < 0 ? answer : 0;
}

static int send_all(void *unused)
{
	ktime_t due = ktime_get();
	unsigned int k;

	for (k = 0; k < count && !kthread_should_stop(); k++) {
		if (period_us) {
			due = ktime_add_us(due, period_us);
			set_current_state(TASK_UNINTERRUPTIBLE);
			schedule_hrtimeout(&due, HRTIMER_MODE_ABS);
		}
		if (send_one(k))
			refused++;
		sent++;
	}
	while (!kthread_should_stop())
		schedule_timeout_interruptible(HZ / 10);
	return 0;
}

static void heard(struct cn_msg *msg, struct netlink_skb_parms *parms)
{
}

static int __init sender_init(void)
{
	int error;

	if (n_rx < 1 || n_rx > 3 || n_tx < 1 || n_tx > 3)
		return -EINVAL;
	error = cn_add_callback(&id, "iwlagn", heard);
	if (error)
		return error;
	sender = kthread_run(send_all, NULL, "csi5300_sender");
	if (IS_ERR(sender)) {
		cn_del_callback(&id);
		return PTR_ERR(sender);
	}
	return 0;
}

static void __exit sender_exit(void)
{
	kthread_stop(sender);
	cn_del_callback(&id);
}

module_init(sender_init);
module_exit(sender_exit);
MODULE_LICENSE("GPL");
MODULE_DESCRIPTION("Sends bfee records through the connector, without a card");
