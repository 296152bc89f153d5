// SPDX-License-Identifier: GPL-2.0
/*
 * CSI of the Intel 5300 beside the distribution's own iwlwifi and iwldvm.
 *
 * The CSI firmware sends its notification 0xBB; the stock driver ignores it. A kprobe on
 * iwl_notification_wait (exported by iwlwifi, called for every packet of a card) sees it. This module makes the
 * record that csitool's or the WSR driver would make and sends it over the kernel connector under their name and
 * index, so their listeners work unchanged. A second kprobe, on the transmit function, gives frames to the magic address
 * an HT rate and no retries; two more send the patched drivers' requests to the card (csi5300_asks.h).
 *
 * The module changes no code of the driver and uses none of its structures, only bytes of the firmware's interface
 * (dvm/commands.h) and arguments of four functions. csi5300_records.h has the rules of the records.
 *
 * GPL (version 2), unlike the rest of the project: only such modules may use kprobes and the connector.
 */
#define pr_fmt(fmt) KBUILD_MODNAME ": " fmt
#include <linux/connector.h>
#include <linux/if_arp.h>
#include <linux/irq_work.h>
#include <linux/kallsyms.h>
#include <linux/kfifo.h>
#include <linux/kprobes.h>
#include <linux/mm.h>
#include <linux/module.h>
#include <linux/netdevice.h>
#include <linux/skbuff.h>
#include <linux/timekeeping.h>
#include <linux/vmalloc.h>
#include <linux/workqueue.h>

#include "csi5300_records.h"
#include "csi5300_cards.h"

#define CN_IDX_IWLAGN (CN_NETLINK_USERS + 0xf)
#define CN_VAL_IWLAGN 0x1
#define VAL_ANSWER 0x0   /* in the ring: a frame to be answered, not a message */
#define CARDS 8
#define RING (1 << 20)   /* bytes: 4,000 records of 3x1 */
/* Bytes of struct iwl_tx_cmd (dvm/commands.h), the payload of REPLY_TX. */
#define TX_LEN 0
#define TX_FLAGS 4
#define TX_RATE 12
#define TX_RTS_RETRIES 49
#define TX_DATA_RETRIES 50
#define TX_FLG_STA_RATE 0x10

static const u8 magic[6] = { 0x00, 0x16, 0xea, 0x12, 0x34, 0x56 };

struct known {
	const void *key; /* argument 1 of iwl_notification_wait: one for each card */
	unsigned long from; /* last caller of the function */
	bool ours, named; /* named: its slot has a name */
	u8 asked; /* packets since module and slot were last looked up */
	u8 slot; /* its entry in index and answer_on */
	u64 last;
	struct card card;
};

static char *symbol = "iwl_notification_wait";
module_param(symbol, charp, 0444);
MODULE_PARM_DESC(symbol, "function that sees every packet");
static char *transmit = "iwl_trans_pcie_tx";
module_param(transmit, charp, 0444);
MODULE_PARM_DESC(transmit, "function that transmits a frame");
static char *caller = "iwldvm";
module_param(caller, charp, 0444);
MODULE_PARM_DESC(caller, "module whose packets count; other Intel cards use another module");
static unsigned int connector_log = LOG_BFEE;
module_param(connector_log, uint, 0644);
MODULE_PARM_DESC(connector_log, "records to send: 0x1 CSI, 0x4 frames");
static unsigned int indices[CARDS] = { [0 ... CARDS - 1] = CN_IDX_IWLAGN };
module_param_array_named(index, indices, uint, NULL, 0444);
MODULE_PARM_DESC(index, "connector index of each card: cards named by `card` or `answer_on` first, others in the order of their first packets");
static char *names[CARDS];
module_param_array_named(card, names, charp, NULL, 0444);
MODULE_PARM_DESC(card, "card of each index and answer_on: MAC, bus address (0000:03:00.0) or interface");
static unsigned int ack_len;
module_param(ack_len, uint, 0644);
MODULE_PARM_DESC(ack_len, "length of the sounding frames to answer, FCS included; 0: none");
static char *answer_on[CARDS];
module_param_array(answer_on, charp, NULL, 0444);
MODULE_PARM_DESC(answer_on, "monitor interface of each card on which to answer");
static unsigned int monitor_tx_rate = 0x4101;
static u8 layout = LAYOUT_STOCK;

static u32 delivered, unheard, ring_full, rates_set, answered, unanswered, unmarked;
static unsigned long missed_before; /* by removed probes */
static struct known known[CARDS];
static bool some_named; /* slots */
static u64 clock;
static DEFINE_RAW_SPINLOCK(lock);
static struct counts gone; /* of cards that others replaced */
static STRUCT_KFIFO_REC_2(RING) *ring;
static union {
	struct cn_msg msg;
	u8 bytes[sizeof(struct cn_msg) + 1 + LONGEST_FRAME];
} *staged, *popped;
static struct workqueue_struct *queue;
static struct cb_id id = { .idx = CN_IDX_IWLAGN, .val = CN_VAL_IWLAGN };

#include "csi5300_asks.h"

static void work(struct work_struct *unused);
static DECLARE_WORK(deliver, work);

static void wake(struct irq_work *unused)
{
	queue_work(queue, &deliver);
}
static struct irq_work waker;

/* Puts a record into the ring; the caller holds the lock. A probe must not send netlink messages. */
static void stage(u32 idx, u32 val, const struct message *out)
{
	u32 len = 1 + out->head_len + out->tail_len;

	memset(&staged->msg, 0, sizeof(staged->msg));
	staged->msg.id.idx = idx;
	staged->msg.id.val = val;
	staged->msg.len = len;
	staged->msg.data[0] = out->code;
	memcpy(staged->msg.data + 1, out->head, out->head_len);
	memcpy(staged->msg.data + 1 + out->head_len, out->tail, out->tail_len);
	if (!kfifo_in(ring, staged->bytes, sizeof(staged->msg) + len))
		ring_full++;
}

/* Answers a frame as the WSR driver does: a copy with one more byte, address 3 the interface's own. */
static bool answer(unsigned int k, const u8 *frame, u32 len)
{
	static const u8 radiotap[8] = { 0, 0, sizeof(radiotap) };
	struct net_device *dev = k < CARDS && answer_on[k] ? dev_get_by_name(&init_net, answer_on[k]) : NULL;
	struct sk_buff *skb = NULL;

	if (dev && dev->type == ARPHRD_IEEE80211_RADIOTAP && netif_running(dev))
		skb = alloc_skb(LL_RESERVED_SPACE(dev) + sizeof(radiotap) + len + 1, GFP_KERNEL);
	if (skb) {
		skb_reserve(skb, LL_RESERVED_SPACE(dev));
		skb_reset_mac_header(skb);
		skb_put_data(skb, radiotap, sizeof(radiotap));
		skb_put_data(skb, frame, len);
		skb_put_data(skb, "", 1);
		memcpy(skb->data + sizeof(radiotap) + 16, dev->dev_addr, 6);
		skb->dev = dev;
		skb->protocol = htons(ETH_P_802_2);
		/* Sent or not, the skb no longer belongs to us. */
		if (dev_queue_xmit(skb))
			skb = NULL;
	}
	if (dev)
		dev_put(dev);
	return skb;
}

static void work(struct work_struct *unused)
{
	struct cn_msg *msg = &popped->msg;

	while (kfifo_out(ring, popped->bytes, sizeof(popped->bytes))) {
		if (msg->id.val == VAL_ANSWER) {
			if (answer(msg->id.idx, msg->data + 1, msg->len - 1))
				answered++;
			else
				unanswered++;
		} else if (cn_netlink_send(msg, 0, msg->id.idx, GFP_KERNEL)) {
			unheard++;
		} else {
			delivered++;
		}
		cond_resched();
	}
}

enum whose { OURS, OTHERS, HIDDEN };

/* The caller of the probed function. A tracer (function_graph) hides it; then the next look-up tries again. */
static enum whose whose_call(unsigned long from)
{
	static char name[KSYM_SYMBOL_LEN];
	char *module;

	if (!*caller)
		return OURS;
	sprint_symbol(name, from);
	module = strrchr(name, '[');
	if (!module)
		return HIDDEN;
	return strlen(module) == strlen(caller) + 2 && !strncmp(module + 1, caller, strlen(caller)) ? OURS : OTHERS;
}

/* Name of a slot's card, else its answering interface. NULL if it has neither. */
static const char *name_of(unsigned int slot)
{
	if (names[slot] && *names[slot])
		return names[slot];
	return answer_on[slot] && *answer_on[slot] ? answer_on[slot] : NULL;
}

/* The slot with this card's name, or CARDS. */
static unsigned int named_slot(const void *key)
{
	struct wiphy *wiphy;
	unsigned int k;

	if (!some_named)
		return CARDS;
	rcu_read_lock();
	wiphy = wiphy_of(key);
	for (k = 0; k < CARDS; k++)
		if (wiphy && name_of(k) && is_called(wiphy, name_of(k)))
			break;
	rcu_read_unlock();
	return k;
}

/* A free slot without a name, or CARDS. */
static unsigned int free_slot(void)
{
	unsigned int k, used = 0;

	for (k = 0; k < CARDS; k++) {
		used |= name_of(k) ? 1u << k : 0;
		used |= known[k].ours ? 1u << known[k].slot : 0;
	}
	return ffz(used);
}

/* Keeps the counts of a card whose place another takes. */
static void forget(struct known *card)
{
	const u32 *of = (const u32 *)&card->card.counts;
	unsigned int i;

	for (i = 0; card->ours && i < sizeof(gone) / sizeof(u32); i++)
		((u32 *)&gone)[i] += of[i];
	memset(card, 0, sizeof(*card));
}

/* Whether a card is ours, and its slot. */
static void look_up(struct known *card, unsigned long from)
{
	enum whose by = whose_call(from);
	unsigned int slot;

	if (by == OTHERS && card->ours) {
		/* Our card is gone: another driver's card has the same address. */
		const void *key = card->key;

		forget(card);
		card->key = key;
	}
	card->from = from;
	if (by != OURS && !card->ours)
		return;
	slot = named_slot(card->key);
	card->named = slot < CARDS;
	if (!card->named && !card->ours)
		slot = free_slot();
	if (slot < CARDS) {
		card->slot = slot;
		card->ours = true;
	}
}

/* The card of this key, if its packets come from the right module; `anew`: its firmware has started. The caller holds the lock. */
static struct known *card_of(const void *key, unsigned long from, bool anew)
{
	struct known *card, *oldest = known;
	bool settled;
	unsigned int k;

	for (k = 0; k < CARDS; k++) {
		card = &known[k];
		if (card->key == key)
			goto found;
		if (card->last < oldest->last)
			oldest = card;
	}
	card = oldest;
	forget(card);
	card->key = key;
found:
	settled = card->ours && (card->named || !some_named);
	if (anew || from != card->from || (!settled && !(card->asked++ & 63)))
		look_up(card, from);
	card->last = ++clock;
	return card->ours ? card : NULL;
}

/* Bytes from here to the end of the page: a card's counts are trusted only up to there. */
static u32 room_at(const void *here)
{
	struct page *page = virt_to_head_page(here);

	return (u8 *)page_address(page) + (PAGE_SIZE << compound_order(page)) - (const u8 *)here;
}

/* iwl_notification_wait(notif_data, pkt): u32 length and flags, u8 command, u8 group, u16 sequence, data. */
static int on_packet(struct kprobe *probe, struct pt_regs *regs)
{
	const u8 *packet = (const u8 *)regs->si;
	struct options options = { .layout = READ_ONCE(layout), .log = READ_ONCE(connector_log) };
	struct message out;
	struct timespec64 now;
	struct known *card;
	unsigned long flags;
	u32 size;
	u8 cmd;

	if (!packet || !virt_addr_valid(packet) || room_at(packet) < 8)
		return 0;
	cmd = packet[4];
	if (cmd != BFEE_NOTIF && cmd != RX_PHY && cmd != RX_MPDU && cmd != REPLY_ALIVE)
		return 0;
	size = get32(packet) & 0x3fff;
	if (size < 4)
		return 0;
	size = min_t(u32, size - 4, room_at(packet) - 8);
	ktime_get_real_ts64(&now);
	raw_spin_lock_irqsave(&lock, flags);
	card = card_of((const void *)regs->di, *(unsigned long *)regs->sp, cmd == REPLY_ALIVE);
	if (card) {
		u32 idx = card->slot, len = READ_ONCE(ack_len);
		bool sent = assemble(&card->card, &options, cmd, packet + 8, size, now.tv_sec, now.tv_nsec / 1000, &out);

		/* Unless the card marks it as a notification, the driver looks for the command that it answers. */
		unmarked += cmd == BFEE_NOTIF && !(packet[7] & 0x80);
		if (sent)
			stage(indices[idx], CN_VAL_IWLAGN, &out);
		if (cmd == RX_MPDU && len >= 28 && answer_on[idx] && *answer_on[idx] && frame_of(packet + 8, size, &out.tail) == len &&
		    frame_good(out.tail, len) && !memcmp(out.tail + 4, magic, 6)) {
			out.head_len = 0;
			out.tail_len = len;
			stage(idx, VAL_ANSWER, &out);
			sent = true;
		}
		if (sent)
			irq_work_queue(&waker);
	}
	raw_spin_unlock_irqrestore(&lock, flags);
	return 0;
}

/* iwl_trans_pcie_tx(trans, skb, dev_cmd, queue): dev_cmd is u8 command, u8 group, u16 sequence, struct iwl_tx_cmd. */
static int on_transmit(struct kprobe *probe, struct pt_regs *regs)
{
	const struct sk_buff *skb = (const struct sk_buff *)regs->si;
	u8 *command = (u8 *)regs->dx, *tx = command + 4;
	u32 rate = READ_ONCE(monitor_tx_rate);

	if (!rate || !skb || !command || command[0] != REPLY_TX || skb_headlen(skb) < 24)
		return 0;
	if ((skb->data[0] & 0x0c) != 0x08 || memcmp(skb->data + 4, magic, 6) || get16(tx + TX_LEN) != (u16)skb->len)
		return 0;
	put32(tx + TX_FLAGS, get32(tx + TX_FLAGS) & ~TX_FLG_STA_RATE);
	put32(tx + TX_RATE, rate);
	tx[TX_RTS_RETRIES] = 0;
	tx[TX_DATA_RETRIES] = 0;
	rates_set++;
	return 0;
}

/* Probes come and go with the modules that contain their functions. */
enum { PACKETS, FRAMES, COMMANDS, PROBES };
static struct kprobe probes[PROBES];
static bool probing[PROBES], waiting[PROBES];
static DEFINE_MUTEX(probes_lock);

static void unprobe(const struct module *of)
{
	unsigned int k;

	unprobe_return(of);
	for (k = 0; k < PROBES; k++) {
		if (!probing[k] || (of && !within_module((unsigned long)probes[k].addr, of)))
			continue;
		unregister_kprobe(&probes[k]);
		probing[k] = false;
	}
}

static void probe(void)
{
	static const kprobe_pre_handler_t handlers[PROBES] = { on_packet, on_transmit, on_command };
	const char *const functions[PROBES] = { symbol, transmit, "iwl_dvm_send_cmd_pdu" };
	static const char *const parameters[] = { "symbol", "transmit" };
	static bool warned[ARRAY_SIZE(parameters)];
	bool driver = false;
	unsigned int k;
	int error;

	for (k = 0; k < PROBES; k++) {
		if (probing[k])
			continue;
		missed_before += probes[k].nmissed;
		memset(&probes[k], 0, sizeof(probes[k]));
		probes[k].symbol_name = functions[k];
		probes[k].pre_handler = handlers[k];
		error = register_kprobe(&probes[k]);
		probing[k] = !error;
		if (!error)
			pr_info("probe at %s\n", probes[k].symbol_name);
		else if (error == -ENOENT && !waiting[k])
			pr_info("no function %s yet: is the driver loaded?\n", functions[k]);
		else if (error != -ENOENT)
			pr_warn("no probe at %s (%d)\n", probes[k].symbol_name, error);
		waiting[k] = error == -ENOENT;
	}
	for (k = 0; k < PROBES; k++)
		driver |= probing[k];
	for (k = 0; k < ARRAY_SIZE(parameters); k++) {
		if (!driver || !waiting[k] || warned[k])
			continue;
		pr_warn("the driver is loaded and has no function %s: is %s= right?\n", functions[k], parameters[k]);
		warned[k] = true;
	}
	if (probing[COMMANDS])
		probe_return(probes[COMMANDS].addr);
}

static int modules_change(struct notifier_block *block, unsigned long event, void *module)
{
	if (module == THIS_MODULE || (event != MODULE_STATE_LIVE && event != MODULE_STATE_GOING))
		return NOTIFY_DONE;
	mutex_lock(&probes_lock);
	if (event == MODULE_STATE_LIVE)
		probe();
	else
		unprobe(module);
	/* The driver's cards are gone. Cards of its next load may reuse their keys. */
	if (event == MODULE_STATE_GOING && !strncmp(((struct module *)module)->name, "iwl", 3)) {
		unsigned long flags;
		unsigned int k;

		raw_spin_lock_irqsave(&lock, flags);
		for (k = 0; k < CARDS; k++)
			forget(&known[k]);
		raw_spin_unlock_irqrestore(&lock, flags);
	}
	mutex_unlock(&probes_lock);
	return NOTIFY_DONE;
}
static struct notifier_block modules = { .notifier_call = modules_change };

static int layout_set(const char *value, const struct kernel_param *param)
{
	if (!sysfs_streq(value, "stock") && !sysfs_streq(value, "wsr"))
		return -EINVAL;
	layout = sysfs_streq(value, "wsr") ? LAYOUT_WSR : LAYOUT_STOCK;
	return 0;
}

static int layout_get(char *buffer, const struct kernel_param *param)
{
	return scnprintf(buffer, PAGE_SIZE, "%s\n", layout == LAYOUT_WSR ? "wsr" : "stock");
}
static const struct kernel_param_ops layout_ops = { .set = layout_set, .get = layout_get };
module_param_cb(layout, &layout_ops, NULL, 0644);
MODULE_PARM_DESC(layout, "layout of the records: csitool's (stock) or the WSR driver's (wsr)");

static int rate_get(char *buffer, const struct kernel_param *param)
{
	return scnprintf(buffer, PAGE_SIZE, "0x%x\n", monitor_tx_rate);
}
static const struct kernel_param_ops rate_ops = { .set = param_set_uint, .get = rate_get };
module_param_cb(monitor_tx_rate, &rate_ops, &monitor_tx_rate, 0644);
MODULE_PARM_DESC(monitor_tx_rate, "rate_n_flags of frames to 00:16:ea:12:34:56 (0x4101: MCS 1, antenna A); 0: unchanged");

/* /sys/module/csi5300/counters: one file each, sums over the cards. Newer kernels pass the attribute as const. */
typedef typeof(_Generic(((struct module_attribute *)0)->show,
			ssize_t (*)(const struct module_attribute *, struct module_kobject *, char *): (const struct module_attribute *)0,
			default: (struct module_attribute *)0)) attribute_of;
static ssize_t show(attribute_of attr, struct module_kobject *module, char *buffer);
#define ATTRIBUTE(name) static struct module_attribute name##_file = __ATTR(name, 0444, show, NULL);
#define LISTED(name) &name##_file.attr,
#define OWN(X) X(delivered) X(unheard) X(ring_full) X(rates_set) X(answered) X(unanswered) X(unmarked) X(rxons) X(stations) \
	X(orders) X(unasked)
COUNTS(ATTRIBUTE)
OWN(ATTRIBUTE)
static struct module_attribute missed_file = __ATTR(missed, 0444, show, NULL);
static struct attribute *files[] = { COUNTS(LISTED) OWN(LISTED) &missed_file.attr, NULL };
static const struct attribute_group counters = { .name = "counters", .attrs = files };

static ssize_t show(attribute_of attr, struct module_kobject *module, char *buffer)
{
	u32 sum = missed_before + missed_returns();
	unsigned int k;

	for (k = 0; k < PROBES; k++)
		sum += probes[k].nmissed;

#define SUM(name) if (attr == &name##_file) for (sum = gone.name, k = 0; k < CARDS; k++) sum += known[k].card.counts.name;
#define ONE(name) if (attr == &name##_file) sum = name;
	COUNTS(SUM)
	OWN(ONE)
	return scnprintf(buffer, PAGE_SIZE, "%u\n", sum);
}

static void unused_callback(struct cn_msg *msg, struct netlink_skb_parms *parms)
{
}

static void release(void)
{
	if (queue)
		destroy_workqueue(queue);
	vfree(ring);
	kfree(staged);
	kfree(popped);
}

static int __init csi5300_init(void)
{
	int error = -ENOMEM;
	unsigned int k;

	for (k = 0; k < CARDS; k++)
		some_named |= !!name_of(k);
	init_irq_work(&waker, wake);
	ring = vmalloc(sizeof(*ring));
	staged = kmalloc(sizeof(*staged), GFP_KERNEL);
	popped = kmalloc(sizeof(*popped), GFP_KERNEL);
	queue = alloc_ordered_workqueue("csi5300", WQ_HIGHPRI);
	if (!ring || !staged || !popped || !queue)
		goto failed;
	INIT_KFIFO(*ring);
	error = cn_add_callback(&id, "iwlagn", unused_callback);
	if (error) {
		pr_err("the connector index of the CSI driver is taken: is the patched iwlwifi loaded?\n");
		goto failed;
	}
	error = sysfs_create_group(&THIS_MODULE->mkobj.kobj, &counters);
	if (!error)
		error = register_module_notifier(&modules);
	if (error) {
		cn_del_callback(&id);
		goto failed;
	}
	mutex_lock(&probes_lock);
	probe();
	mutex_unlock(&probes_lock);
	return 0;
failed:
	release();
	return error;
}

static void __exit csi5300_exit(void)
{
	unregister_module_notifier(&modules);
	mutex_lock(&probes_lock);
	unprobe(NULL);
	mutex_unlock(&probes_lock);
	irq_work_sync(&waker);
	cancel_work_sync(&deliver);
	sysfs_remove_group(&THIS_MODULE->mkobj.kobj, &counters);
	cn_del_callback(&id);
	release();
}

module_init(csi5300_init);
module_exit(csi5300_exit);
MODULE_LICENSE("GPL");
MODULE_VERSION("0.1.0");
MODULE_SOFTDEP("pre: iwlwifi");
MODULE_DESCRIPTION("CSI of the Intel 5300 beside the stock iwlwifi");
