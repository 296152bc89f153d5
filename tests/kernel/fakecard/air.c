// SPDX-License-Identifier: GPL-2.0
/*
 * The air between the cards, simulated in user space through /dev/fakecard:
 *   read: one transmission: struct air_head (u8 card, u8 0, u16 length, u32 rate_n_flags, u32 tx_flags, u8 rts and data
 *     retry limits, u16 0, u64 microseconds of the host), then the frame;
 *   write: one packet for a card: u8 card, u8 0, u16 length of what follows, then the packet as the card would put it
 *     into memory (u32 length and flags, u8 command, u8 group, u16 sequence, data), valid or not.
 */
#include <linux/kfifo.h>
#include <linux/ktime.h>
#include <linux/miscdevice.h>
#include <linux/module.h>
#include <linux/poll.h>
#include <linux/skbuff.h>
#include <linux/slab.h>
#include <linux/uaccess.h>
#include <linux/vmalloc.h>
#include "fakecard.h"

#define AIR (1 << 20)

static unsigned int cards = 2;
module_param(cards, uint, 0444);
static unsigned long lost;
module_param(lost, ulong, 0444);
MODULE_PARM_DESC(lost, "transmissions that were not read in time");

static STRUCT_KFIFO_REC_2(AIR) *air;
static DEFINE_SPINLOCK(air_lock);
static DECLARE_WAIT_QUEUE_HEAD(air_queue);

void on_air(struct air_head *head, const struct sk_buff *skb)
{
	static u8 record[sizeof(*head) + LONGEST_FRAME];

	head->len = cpu_to_le16(skb->len);
	head->us = cpu_to_le64(ktime_to_us(ktime_get()));
	spin_lock_bh(&air_lock);
	memcpy(record, head, sizeof(*head));
	skb_copy_bits(skb, 0, record + sizeof(*head), skb->len);
	if (!kfifo_in(air, record, sizeof(*head) + skb->len))
		lost++;
	spin_unlock_bh(&air_lock);
	wake_up_interruptible(&air_queue);
}

static ssize_t air_read(struct file *file, char __user *to, size_t size, loff_t *at)
{
	unsigned int copied;
	int error;

	if (kfifo_is_empty(air)) {
		if (file->f_flags & O_NONBLOCK)
			return -EAGAIN;
		error = wait_event_interruptible(air_queue, !kfifo_is_empty(air));
		if (error)
			return error;
	}
	error = kfifo_to_user(air, to, size, &copied);
	return error ? error : copied;
}

static ssize_t air_write(struct file *file, const char __user *from, size_t size, loff_t *at)
{
	u8 *bytes = size < 12 || size > U16_MAX ? ERR_PTR(-EINVAL) : memdup_user(from, size);
	int error = -EINVAL;

	if (IS_ERR(bytes))
		return PTR_ERR(bytes);
	if ((bytes[2] | bytes[3] << 8) == size - 4)
		error = deliver(bytes[0], bytes + 4, size - 4);
	kfree(bytes);
	return error ? error : size;
}

static __poll_t air_poll(struct file *file, poll_table *table)
{
	poll_wait(file, &air_queue, table);
	return EPOLLOUT | (kfifo_is_empty(air) ? 0 : EPOLLIN);
}

static const struct file_operations air_ops = {
	.owner = THIS_MODULE, .read = air_read, .write = air_write, .poll = air_poll, .llseek = noop_llseek,
};
static struct miscdevice air_device = { .minor = MISC_DYNAMIC_MINOR, .name = "fakecard", .fops = &air_ops };

static int __init fakecard_init(void)
{
	int error;

	air = vmalloc(sizeof(*air));
	if (!air)
		return -ENOMEM;
	INIT_KFIFO(*air);
	error = cards_begin(cards);
	if (!error) {
		error = misc_register(&air_device);
		if (error)
			cards_end();
	}
	if (error)
		vfree(air);
	return error;
}

static void __exit fakecard_exit(void)
{
	misc_deregister(&air_device);
	cards_end();
	vfree(air);
}

module_init(fakecard_init);
module_exit(fakecard_exit);
MODULE_LICENSE("GPL");
MODULE_DESCRIPTION("Fake Intel 5300 cards for tests of the stock driver");
