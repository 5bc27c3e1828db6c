// A node that was chosen: its numbers, and its light by direction.
import { element, place } from './elements.js';
import { luminance, MODES, srgb, UNKNOWN } from './scales.js';

const [ COLUMNS, ROWS ] = [ 64, 32 ];

// Lat-long as probes are: the middle looks along +Z, the left of it is +X.
export const DIRECTIONS = Float32Array.from( { length: 3 * COLUMNS * ROWS }, ( _, k ) => {

	const pixel = Math.floor( k / 3 );
	const longitude = 2 * Math.PI * ( 0.5 - ( pixel % COLUMNS + 0.5 ) / COLUMNS );
	const latitude = Math.PI * ( 0.5 - ( Math.floor( pixel / COLUMNS ) + 0.5 ) / ROWS );
	return [ Math.sin( longitude ) * Math.cos( latitude ), Math.sin( latitude ), Math.cos( longitude ) * Math.cos( latitude ) ][ k % 3 ];

} );

/** `found`: what the worker tells of a node. */
export function details( found, gain ) {

	const canvas = element( 'canvas', { width: COLUMNS, height: ROWS, role: 'img', 'aria-label': 'Irradiance of this node by direction' } );
	const image = new ImageData( COLUMNS, ROWS );
	for ( let k = 0; k < COLUMNS * ROWS; k ++ ) image.data.set( [ ...[ 0, 1, 2 ].map( ( c ) => srgb( gain * found.irradiance[ 3 * k + c ] / Math.PI ) ), 255 ], 4 * k );
	canvas.getContext( '2d' ).putImageData( image, 0, 0 );
	const rows = MODES.filter( ( { key } ) => key in found.figures && found.figures[ key ] !== UNKNOWN ).map( ( { name, key, text } ) => [ name, text( found.figures[ key ] ) ] );
	const least = found.irradiance.reduce( ( a, b ) => Math.min( a, b ), Infinity );
	return element( 'div.details', {},
		element( 'h3', {}, `Node ${ found.node }` ),
		element( 'p', {}, `at ${ place( found.position ) } m${ found.isBaked ? '' : '; it has no light of its own: filled from its neighbours' }` ),
		element( 'dl', {}, [
			[ 'Mean irradiance', `${ found.light.map( ( e ) => e.toPrecision( 3 ) ).join( ' ' ) }, luminance ${ luminance( found.light ).toPrecision( 3 ) }` ], ...rows,
			...( least < 0 ? [ [ 'Rings', `irradiance falls to ${ least.toPrecision( 2 ) } for some normal` ] ] : [] ),
		].map( ( [ name, text ] ) => [ element( 'dt', {}, name ), element( 'dd', {}, text ) ] ) ),
		canvas, element( 'p.hint', {}, 'Irradiance by the direction a surface faces: the middle is +Z, left of it +X, up +Y.' ) );

}

/** A place of a surface that was chosen. */
export function surfaceDetails( { position, irradiance, figure }, mode ) {

	return element( 'div.details', {}, element( 'h3', {}, 'Surface' ),
		element( 'p', {}, `at ${ place( position ) } m` ),
		element( 'dl', {}, element( 'dt', {}, 'Irradiance' ), element( 'dd', {}, irradiance.map( ( e ) => e.toPrecision( 3 ) ).join( ' ' ) ),
			...( mode.light ? [] : [ element( 'dt', {}, mode.name ), element( 'dd', {}, figure === UNKNOWN ? 'not known: the nearest node was filled' : mode.text( figure ) ) ] ) ) );

}
