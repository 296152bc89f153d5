// SPDX-License-Identifier: GPL-2.0
/*
 * Fake Intel 5300 cards for Debian's own iwlwifi.ko and iwldvm.ko of 6.1.
 *
 * Each card is a transport (struct iwl_trans_ops) of this module, on which the real driver runs: it reads an
 * EEPROM image, starts a firmware that answers ALIVE and its commands, transmits and receives. Transmissions are
 * reported done (REPLY_TX) at once, whether anybody listens or not.
 */
#include <linux/etherdevice.h>
#include <linux/kprobes.h>
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/workqueue.h>
#include "iwl-drv.h"
#include "iwl-trans.h"
#include "iwl-config.h"
#include "iwl-csr.h"
#include "iwl-op-mode.h"
#include "commands.h"
#include "fakecard.h"

#define QUEUES 32
#define EEPROM_WORDS 1024
#define REGISTERS 0x4000
#define RX_ORDER 0
#define RX_BYTES (PAGE_SIZE << RX_ORDER)
#define INIT_BYTES 64       /* of the init image's first section; the runtime image has another size */

static bool verbose;
module_param(verbose, bool, 0644);
MODULE_PARM_DESC(verbose, "host commands to the kernel's log");
static bool at_end;
module_param(at_end, bool, 0644);
MODULE_PARM_DESC(at_end, "packets other than frames end at their page's end instead of beginning at its start");
static unsigned long plain, beamforming, stations, orders;
module_param(plain, ulong, 0444);
module_param(beamforming, ulong, 0444);
MODULE_PARM_DESC(beamforming, "RXON commands with bit 29, which the patched drivers set; plain: without it");
module_param(stations, ulong, 0444);
MODULE_PARM_DESC(stations, "ADD_STA commands for station 13 with the magic address");
module_param(orders, ulong, 0444);
MODULE_PARM_DESC(orders, "requests for the antenna order");

struct card {
	struct platform_device *pdev;
	unsigned int number;
	struct iwl_trans *trans;
	struct iwl_op_mode *op_mode;
	struct mutex delivering; /* as on a bus: one packet of a card at a time, but two cards' packets in parallel */
	struct workqueue_struct *queue;
	struct sk_buff_head sent[QUEUES];
	u16 next[QUEUES];
	u16 eeprom[EEPROM_WORDS];
	u32 registers[REGISTERS];
};

struct notice {
	struct work_struct work;
	struct card *card;
	u16 sequence, len;
	u8 cmd;
	u8 data[];
};

static struct card *all[CARDS];

static struct card *card_of(struct iwl_trans *trans)
{
	return *(struct card **)trans->trans_specific;
}

static int into_driver(struct card *card, const void *packet, size_t len)
{
	struct iwl_rx_cmd_buffer rxb = { ._rx_page_order = RX_ORDER, .truesize = RX_BYTES };
	struct page *page;

	if (len > RX_BYTES)
		return -EMSGSIZE;
	page = alloc_pages(GFP_KERNEL | __GFP_ZERO | __GFP_COMP, RX_ORDER);
	if (!page)
		return -ENOMEM;
	if (READ_ONCE(at_end) && ((u8 *)packet)[4] != REPLY_RX_MPDU_CMD)
		rxb._offset = (RX_BYTES - len) & ~3;
	memcpy(page_address(page) + rxb._offset, packet, len);
	rxb._page = page;
	mutex_lock(&card->delivering);
	local_bh_disable();
	if (card->op_mode && (card->trans->state == IWL_TRANS_FW_ALIVE || ((u8 *)packet)[4] == REPLY_ALIVE))
		iwl_op_mode_rx(card->op_mode, NULL, &rxb);
	as_patched(packet, len);
	local_bh_enable();
	mutex_unlock(&card->delivering);
	if (!rxb._page_stolen)
		__free_pages(page, RX_ORDER);
	return 0;
}

int deliver(unsigned int card, const void *packet, size_t len)
{
	return card < CARDS && all[card] ? into_driver(all[card], packet, len) : -ENODEV;
}

static void notice_work(struct work_struct *work)
{
	struct notice *notice = container_of(work, struct notice, work);
	struct iwl_rx_packet *pkt = kzalloc(sizeof(*pkt) + notice->len, GFP_KERNEL);

	if (pkt) {
		pkt->len_n_flags = cpu_to_le32(sizeof(struct iwl_cmd_header) + notice->len);
		pkt->hdr.cmd = notice->cmd;
		pkt->hdr.sequence = cpu_to_le16(notice->sequence);
		memcpy(pkt->data, notice->data, notice->len);
		into_driver(notice->card, pkt, sizeof(*pkt) + notice->len);
		kfree(pkt);
	}
	kfree(notice);
}

/* The same from atomic context. */
static void later(struct card *card, u8 cmd, u16 sequence, const void *data, u16 len)
{
	struct notice *notice = kzalloc(sizeof(*notice) + len, GFP_ATOMIC);

	if (!notice)
		return;
	INIT_WORK(&notice->work, notice_work);
	notice->card = card;
	notice->cmd = cmd;
	notice->sequence = sequence;
	notice->len = len;
	if (len)
		memcpy(notice->data, data, len);
	queue_work(card->queue, &notice->work);
}

static int start_hw(struct iwl_trans *trans)
{
	return 0;
}

static void op_mode_leave(struct iwl_trans *trans)
{
	card_of(trans)->op_mode = NULL;
}

static int start_fw(struct iwl_trans *trans, const struct fw_img *fw, bool run_in_rfkill)
{
	struct iwl_alive_resp alive = { .is_valid = cpu_to_le32(1) };

	alive.ver_subtype = fw->sec[0].len == INIT_BYTES ? 9 : 0; /* INITIALIZE_SUBTYPE */
	later(card_of(trans), REPLY_ALIVE, 0x8000, &alive, sizeof(alive));
	return 0;
}

static void fw_alive(struct iwl_trans *trans, u32 scd_addr)
{
	trans->state = IWL_TRANS_FW_ALIVE;
}

static void drop_sent(struct card *card)
{
	unsigned int q;

	for (q = 0; q < QUEUES; q++) {
		struct sk_buff *skb;

		while ((skb = skb_dequeue(&card->sent[q])))
			if (card->op_mode)
				iwl_op_mode_free_skb(card->op_mode, skb);
	}
}

static void stop_device(struct iwl_trans *trans)
{
	trans->state = IWL_TRANS_NO_FW;
	drop_sent(card_of(trans));
}

/* The patched drivers' requests to a card, in the driver's own structures. */
static void note_asked(u8 id, const void *data, u16 len)
{
	static const u8 order[] = { 1, 0, 0, 0, 0x02, 0x43, 0, 0 }; /* struct iwl5000_dsp_debug of csitool's driver */
	static const u8 magic[] = { 0x00, 0x16, 0xea, 0x12, 0x34, 0x56 };
	const struct iwl_addsta_cmd *station = data;
	const struct iwl_rxon_cmd *rxon = data;

	if (id == REPLY_RXON && len == sizeof(*rxon) && le32_to_cpu(rxon->flags) & BIT(29))
		beamforming++;
	else if (id == REPLY_RXON)
		plain++;
	if (id == REPLY_ADD_STA && len == sizeof(*station) && station->sta.sta_id == 13 && !station->mode)
		stations += !memcmp(station->sta.addr, magic, sizeof(magic));
	if (id == 0xf1 && len == sizeof(order))
		orders += !memcmp(data, order, sizeof(order));
}

static int send_cmd(struct iwl_trans *trans, struct iwl_host_cmd *cmd)
{
	struct card *card = card_of(trans);
	u8 id = cmd->id & 0xff, ok[16] = { 1 };

	if (verbose)
		pr_info("command 0x%02x, %u bytes %*ph\n", id, cmd->len[0], min_t(int, cmd->len[0], 12), cmd->data[0]);
	note_asked(id, cmd->data[0], cmd->len[0]);
	if (id == CALIBRATION_CFG_CMD)
		later(card, CALIBRATION_COMPLETE_NOTIFICATION, 0x8000, NULL, 0);
	if (id == REPLY_ADD_STA)
		later(card, REPLY_ADD_STA, 0, ok, sizeof(ok));
	if (cmd->flags & CMD_WANT_SKB) {
		struct page *page = alloc_pages(GFP_ATOMIC | __GFP_ZERO | __GFP_COMP, RX_ORDER);

		if (!page)
			return -ENOMEM;
		cmd->resp_pkt = page_address(page);
		cmd->resp_pkt->hdr.cmd = id;
		cmd->resp_pkt->len_n_flags = cpu_to_le32(sizeof(struct iwl_cmd_header) + sizeof(ok));
		memcpy(cmd->resp_pkt->data, ok, sizeof(ok));
		cmd->_rx_page_addr = (unsigned long)page_address(page);
		cmd->_rx_page_order = RX_ORDER;
	}
	if (!(cmd->flags & CMD_ASYNC)) {
		clear_bit(STATUS_SYNC_HCMD_ACTIVE, &trans->status);
		wake_up(&trans->wait_command_queue);
	}
	return 0;
}

static void report_done(struct card *card, int q, u16 at, const struct iwl_tx_cmd *tx)
{
	struct {
		struct iwlagn_tx_resp head;
		__le32 ssn;
	} __packed done = {};

	done.head.frame_count = 1;
	done.head.rate_n_flags = tx->rate_n_flags;
	done.head.ra_tid = tx->sta_id << 4 | (tx->tid_tspec & 0xf);
	done.head.status.status = cpu_to_le16(TX_STATUS_SUCCESS);
	done.ssn = cpu_to_le32(at + 1);
	later(card, REPLY_TX, (q & 0x1f) << 8 | (at & 0xff), &done, sizeof(done));
}

/* Not inlined and not static: takes the place of iwl_trans_pcie_tx of a card on a bus. */
int fakecard_tx(struct iwl_trans *trans, struct sk_buff *skb, struct iwl_device_tx_cmd *dev_cmd, int q);
noinline int fakecard_tx(struct iwl_trans *trans, struct sk_buff *skb, struct iwl_device_tx_cmd *dev_cmd, int q)
{
	struct card *card = card_of(trans);
	struct iwl_tx_cmd *tx = (void *)dev_cmd->payload;
	struct air_head head = {
		.card = card->number, .rate = tx->rate_n_flags, .flags = tx->tx_flags,
		.rts_retries = tx->rts_retry_limit, .data_retries = tx->data_retry_limit,
	};

	if (q < 0 || q >= QUEUES || skb->len > LONGEST_FRAME)
		return -EINVAL;
	on_air(&head, skb);
	skb_queue_tail(&card->sent[q], skb);
	report_done(card, q, card->next[q]++, tx);
	return 0;
}

static void reclaim(struct iwl_trans *trans, int q, int ssn, struct sk_buff_head *skbs, bool is_flush)
{
	struct sk_buff *skb = q >= 0 && q < QUEUES ? skb_dequeue(&card_of(trans)->sent[q]) : NULL;

	if (skb)
		__skb_queue_tail(skbs, skb);
}

static void set_q_ptrs(struct iwl_trans *trans, int q, int ptr) { }
static bool txq_enable(struct iwl_trans *trans, int q, u16 ssn, const struct iwl_trans_txq_scd_cfg *cfg, unsigned int timeout)
{
	return false;
}
static void txq_disable(struct iwl_trans *trans, int q, bool configure_scd) { }
static void txq_set_shared_mode(struct iwl_trans *trans, u32 q, bool shared) { }
static int wait_empty(struct iwl_trans *trans, u32 queues) { return 0; }
static void freeze_timer(struct iwl_trans *trans, unsigned long queues, bool freeze) { }
static void block_ptrs(struct iwl_trans *trans, bool block) { }

static u32 read32(struct iwl_trans *trans, u32 at)
{
	return card_of(trans)->registers[at / 4 % REGISTERS];
}

static void write32(struct iwl_trans *trans, u32 at, u32 value)
{
	struct card *card = card_of(trans);

	if (at == CSR_EEPROM_REG)
		value = CSR_EEPROM_REG_READ_VALID_MSK | (u32)card->eeprom[(value >> 2) % EEPROM_WORDS] << 16;
	card->registers[at / 4 % REGISTERS] = value;
}

static void write8(struct iwl_trans *trans, u32 at, u8 value) { }
static u32 read_prph(struct iwl_trans *trans, u32 at) { return 0; }
static void write_prph(struct iwl_trans *trans, u32 at, u32 value) { }
static int read_mem(struct iwl_trans *trans, u32 at, void *to, int words)
{
	memset(to, 0, words * 4);
	return 0;
}
static int write_mem(struct iwl_trans *trans, u32 at, const void *from, int words) { return 0; }

static void configure(struct iwl_trans *trans, const struct iwl_trans_config *config)
{
	card_of(trans)->op_mode = config->op_mode;
	trans->command_groups = config->command_groups;
	trans->command_groups_size = config->command_groups_size;
	trans->txqs.cmd.q_id = config->cmd_queue;
}

static void set_pmi(struct iwl_trans *trans, bool state) { }
static int sw_reset(struct iwl_trans *trans, bool retake) { return 0; }
static bool grab(struct iwl_trans *trans) { return true; }
static void let_go(struct iwl_trans *trans) { }
static void set_bits(struct iwl_trans *trans, u32 at, u32 mask, u32 value)
{
	write32(trans, at, (read32(trans, at) & ~mask) | value);
}

static const struct iwl_trans_ops ops = {
	.start_hw = start_hw, .op_mode_leave = op_mode_leave, .start_fw = start_fw, .fw_alive = fw_alive,
	.stop_device = stop_device, .send_cmd = send_cmd, .tx = fakecard_tx, .reclaim = reclaim, .set_q_ptrs = set_q_ptrs,
	.txq_enable = txq_enable, .txq_disable = txq_disable, .txq_set_shared_mode = txq_set_shared_mode,
	.wait_tx_queues_empty = wait_empty, .freeze_txq_timer = freeze_timer, .block_txq_ptrs = block_ptrs,
	.write8 = write8, .write32 = write32, .read32 = read32, .read_prph = read_prph, .write_prph = write_prph,
	.read_mem = read_mem, .write_mem = write_mem, .configure = configure, .set_pmi = set_pmi, .sw_reset = sw_reset,
	.grab_nic_access = grab, .release_nic_access = let_go, .set_bits_mask = set_bits,
};

static struct iwl_trans *(*trans_alloc)(unsigned int, struct device *, const struct iwl_trans_ops *,
					const struct iwl_cfg_trans_params *);
static int (*trans_init)(struct iwl_trans *);
static void (*trans_free)(struct iwl_trans *);
static struct iwl_drv *(*drv_start)(struct iwl_trans *);
static void (*drv_stop)(struct iwl_drv *);
static void (*dbg_init)(struct iwl_trans *);
static const struct iwl_cfg *cfg;

static void fill_eeprom(struct card *card, unsigned int k)
{
	unsigned int at;
	static const u16 words[][2] = {
		{ 0x88, 0x011f }, { 0x8a, 0x0070 }, { 0x90, 0x0770 },  /* version, calibration, antennas and SKU */
		{ 0x2a, 0x2100 }, { 0x2c, 0x006a },                    /* MAC 00:21:6a:00:00:0k */
		{ 0xcc, 0x0180 }, { 0xce, 0x0080 }, { 0x100, 0x0006 }, /* links */
	};

	for (at = 0; at < ARRAY_SIZE(words); at++)
		card->eeprom[words[at][0] / 2] = words[at][1];
	card->eeprom[0x2e / 2] = (k + 1) << 8;
	for (at = 0x308; at < 0x3a0; at += 2)
		card->eeprom[at / 2] = 0x0f2b; /* every channel: valid, IBSS, active, wide; 15 dBm */
	card->registers[CSR_EEPROM_GP / 4] = 2; /* a good signature, no OTP */
}

static void remove(struct card *card)
{
	unsigned int q;

	if (card->trans && !IS_ERR_OR_NULL(card->trans->drv))
		drv_stop(card->trans->drv);
	if (card->queue)
		destroy_workqueue(card->queue);
	for (q = 0; q < QUEUES; q++)
		skb_queue_purge(&card->sent[q]);
	if (card->trans)
		trans_free(card->trans);
	if (!IS_ERR_OR_NULL(card->pdev))
		platform_device_unregister(card->pdev);
	kvfree(card);
}

static int add(unsigned int k)
{
	struct card *card = kvzalloc(sizeof(*card), GFP_KERNEL);
	unsigned int q;

	if (!card)
		return -ENOMEM;
	all[k] = card;
	card->number = k;
	mutex_init(&card->delivering);
	for (q = 0; q < QUEUES; q++)
		skb_queue_head_init(&card->sent[q]);
	fill_eeprom(card, k);
	card->queue = alloc_ordered_workqueue("fakecard%u", 0, k);
	card->pdev = platform_device_register_simple("fakecard", k, NULL, 0);
	if (!card->queue || IS_ERR(card->pdev))
		return -ENOMEM;
	dma_set_mask_and_coherent(&card->pdev->dev, DMA_BIT_MASK(36));
	card->trans = trans_alloc(sizeof(void *), &card->pdev->dev, &ops, &cfg->trans);
	if (!card->trans)
		return -ENOMEM;
	*(struct card **)card->trans->trans_specific = card;
	card->trans->cfg = cfg;
	card->trans->name = cfg->name;
	card->trans->hw_rev = 0x24;
	strscpy(card->trans->hw_id_str, "fake", sizeof(card->trans->hw_id_str));
	dbg_init(card->trans);
	if (trans_init(card->trans))
		return -EIO;
	card->trans->drv = drv_start(card->trans);
	return PTR_ERR_OR_ZERO(card->trans->drv);
}

static int find_functions(void)
{
	struct kprobe probe = { .symbol_name = "kallsyms_lookup_name" };
	unsigned long (*lookup)(const char *name);
	int error = register_kprobe(&probe);

	if (error)
		return error;
	lookup = (void *)probe.addr;
	unregister_kprobe(&probe);
	trans_alloc = (void *)lookup("iwl_trans_alloc");
	trans_init = (void *)lookup("iwl_trans_init");
	trans_free = (void *)lookup("iwl_trans_free");
	dbg_init = (void *)lookup("iwl_dbg_tlv_init");
	drv_start = (void *)lookup("iwl_drv_start");
	drv_stop = (void *)lookup("iwl_drv_stop");
	cfg = (void *)lookup("iwl5300_agn_cfg");
	return trans_alloc && trans_init && trans_free && dbg_init && drv_start && drv_stop && cfg ? 0 : -ENOENT;
}

void cards_end(void)
{
	unsigned int k;

	for (k = 0; k < CARDS; k++) {
		if (all[k])
			remove(all[k]);
		all[k] = NULL;
	}
}

int cards_begin(unsigned int count)
{
	unsigned int k;
	int error = count && count <= CARDS ? find_functions() : -EINVAL;

	for (k = 0; k < count && !error; k++)
		error = add(k);
	if (error)
		cards_end();
	return error;
}
