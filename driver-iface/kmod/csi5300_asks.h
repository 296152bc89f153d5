/* SPDX-License-Identifier: GPL-2.0 */
/*
 * Requests that csitool's and the WSR driver send to the card and the stock one does not (their dvm/rxon.c, dvm/sta.c). Only a
 * 5300 gets them (csi5300_cards.h), no other card of the driver.
 *
 *   - bit 29 (RXON_FLG_BF_ENABLE) in the flags of every RXON: set in the command when iwl_dvm_send_cmd_pdu gets it. The
 *     bytes are the driver's own copy of its configuration, as in the patched drivers;
 *   - a station 13 with the magic address. RXON empties the card's station table, iwl_restore_stations fills it again;
 *   - the antenna order with each reception (MIB 0x4302, by DSP_DEBUG), after each RXON.
 *
 * The last two are sent when iwl_restore_stations returns, by iwl_dvm_send_cmd_pdu and as asynchronous commands: there
 * the driver holds its mutex, the card is alive, and nothing sleeps. The call is by address, so kernels
 * that check indirect calls (IBT, kCFI) send only the first; so do kernels before 5.11, whose return probes run
 * with interrupts off, and PREEMPT_RT, whose spin locks sleep.
 *
 * Included by csi5300.c only.
 */
#ifndef CSI5300_ASKS_H
#define CSI5300_ASKS_H

#include <linux/version.h>

#define REPLY_RXON 0x10
#define REPLY_RXON_ASSOC 0x11
#define REPLY_ADD_STA 0x18
#define DSP_DEBUG 0xf1
#define RXON_LEN 50       /* struct iwl_rxon_cmd */
#define RXON_FLAGS 32
#define RXON_ASSOC_LEN 24 /* struct iwl_rxon_assoc_cmd, flags first */
#define RXON_BEAMFORMING (1u << 29)
#define STATION_LEN 92    /* struct iwl_addsta_cmd */
#define STATION_ADDRESS 4
#define STATION_ID 12
#define MONITOR_STATION 13
#define ASYNC 0x1         /* CMD_ASYNC */

enum { ASK_BEAMFORMING = 0x1, ASK_STATION = 0x2, ASK_ORDER = 0x4 };
static unsigned int ask = ASK_BEAMFORMING | ASK_STATION | ASK_ORDER;
module_param(ask, uint, 0644);
MODULE_PARM_DESC(ask, "requests to the card, as from the patched drivers: 0x1 CSI (RXON), 0x2 station 13, 0x4 antenna order");

static u32 rxons, stations, orders, unasked;

/* iwl_dvm_send_cmd_pdu(priv, id, flags, len, data) */
static int on_command(struct kprobe *probe, struct pt_regs *regs)
{
	u8 *data = (u8 *)regs->r8;
	u8 id = regs->si;
	u16 len = regs->cx;

	if (!(READ_ONCE(ask) & ASK_BEAMFORMING) || !data)
		return 0;
	if (id == REPLY_RXON && len == RXON_LEN)
		data += RXON_FLAGS;
	else if (id != REPLY_RXON_ASSOC || len != RXON_ASSOC_LEN)
		return 0;
	if (!may_be_asked((const void *)regs->di)) {
		unasked++;
		return 0;
	}
	put32(data, get32(data) | RXON_BEAMFORMING);
	rxons++;
	return 0;
}

#if LINUX_VERSION_CODE >= KERNEL_VERSION(5, 11, 0) && !defined(CONFIG_PREEMPT_RT) && !defined(CONFIG_CFI_CLANG) && !defined(CONFIG_CFI)
static int (*send_command)(void *priv, u8 id, u32 flags, u16 len, const void *data);
static struct kretprobe restored;
static bool restoring;

static int on_restore(struct kretprobe_instance *instance, struct pt_regs *regs)
{
	*(void **)instance->data = (void *)regs->di;
	return 0;
}

static int on_restored(struct kretprobe_instance *instance, struct pt_regs *regs)
{
	static const u8 order[8] = { [0] = 1 /* of */, [4] = 0x02, 0x43 };
	void *priv = *(void **)instance->data;
	u8 station[STATION_LEN] = { [STATION_ID] = MONITOR_STATION };

	if (!may_be_asked(priv))
		return 0;
	memcpy(station + STATION_ADDRESS, magic, sizeof(magic));
	if (READ_ONCE(ask) & ASK_STATION)
		stations += !send_command(priv, REPLY_ADD_STA, ASYNC, sizeof(station), station);
	if (READ_ONCE(ask) & ASK_ORDER)
		orders += !send_command(priv, DSP_DEBUG, ASYNC, sizeof(order), order);
	return 0;
}

/* Calls that both handlers missed. */
static unsigned long missed_returns(void)
{
	return restored.nmissed + restored.kp.nmissed;
}

static bool may_call(void)
{
#if defined(CONFIG_X86_KERNEL_IBT) && defined(X86_FEATURE_IBT)
	return !boot_cpu_has(X86_FEATURE_IBT);
#else
	return true;
#endif
}

/* The probe of iwl_dvm_send_cmd_pdu is set. */
static void probe_return(void *command)
{
	int error;

	if (restoring || !may_call())
		return;
	send_command = command;
	missed_before += missed_returns();
	memset(&restored, 0, sizeof(restored));
	restored.kp.symbol_name = "iwl_restore_stations";
	restored.entry_handler = on_restore;
	restored.handler = on_restored;
	restored.data_size = sizeof(void *);
	restored.maxactive = CARDS;
	error = register_kretprobe(&restored);
	restoring = !error;
	if (!error)
		pr_info("probe at %s\n", restored.kp.symbol_name);
	else if (error != -ENOENT)
		pr_warn("no probe at %s (%d)\n", restored.kp.symbol_name, error);
}

static void unprobe_return(const struct module *of)
{
	if (!restoring || (of && !within_module((unsigned long)restored.kp.addr, of)))
		return;
	unregister_kretprobe(&restored);
	restoring = false;
}
#else
static unsigned long missed_returns(void)
{
	return 0;
}

static void probe_return(void *command)
{
}

static void unprobe_return(const struct module *of)
{
}
#endif

#endif
